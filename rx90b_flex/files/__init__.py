"""Reading files, whatever is in them."""
