"""From measurement to missing effect: compare, locate, attribute, add, verify."""
