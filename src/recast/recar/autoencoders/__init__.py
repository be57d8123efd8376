"""Training of the autoencoders and the image encoder that small models are built on."""
