"""Readers of file formats: bytes in, :class:`~model.io.formats.loaded.Loaded` out."""
