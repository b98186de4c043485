"""What is installed beside the code: manifests and files."""
