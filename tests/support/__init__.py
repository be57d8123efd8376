"""Writers of small test data. No part of the package."""
