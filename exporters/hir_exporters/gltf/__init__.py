"""glTF 2.0: an asset is gathered into a typed document and serialised. One module for each extension."""
