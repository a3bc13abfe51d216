"""What a head is, how it looks, and how it is drawn."""
