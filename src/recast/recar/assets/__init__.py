"""Assets to learn from: voxels, features and pictures of vehicles and other shapes."""
