"""One image to a view-complete vehicle: the TRELLIS image-to-3D model in PyTorch of our own."""
