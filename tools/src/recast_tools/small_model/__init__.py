"""Recipe of `recast-mini`: assets, autoencoders, image encoder, and the assembled model."""
