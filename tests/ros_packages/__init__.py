"""What is installed beside the code: manifests, layouts, container files."""
