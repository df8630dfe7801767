"""One module a file format: bytes in, :class:`~model.io.formats.loaded.Loaded` out."""
