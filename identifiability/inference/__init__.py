"""What can be known: fits, widths, samplers and their referee."""
