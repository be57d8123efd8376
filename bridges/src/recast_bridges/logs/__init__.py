"""Importers of logs in the layouts of other tools."""
