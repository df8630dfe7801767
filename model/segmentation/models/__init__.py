"""Small trained models in plain numpy, and the files that hold them."""
