"""One module a file format: bytes in, :class:`~model.geometry.formats.loaded.Loaded` out."""
