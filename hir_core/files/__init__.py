"""JSON documents, array archives and file names, shared by captures, scenes and runs."""
