"""The two-stage adaptation, and what small models are built on.

`stage.train_stage` runs a stage from a model folder to a new one;
`assemble` makes that folder of the autoencoders and the image encoder, trained by `recipe`.
"""
