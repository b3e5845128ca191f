"""Views of where a model fails, one a file."""
