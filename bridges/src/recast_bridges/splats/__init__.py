"""Formats of Gaussians that other programs read: SPZ and OpenUSD.

Both modules are imported only when a file of theirs is read or written.
"""
