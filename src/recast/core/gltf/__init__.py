"""glTF 2.0 files: the container and the tree of what it draws."""
