"""Image-to-3D models on held-out vehicles: the cells of a table of models and vehicles."""
