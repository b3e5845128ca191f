"""What the findings allow to say: reasons as data, and the words for them."""
