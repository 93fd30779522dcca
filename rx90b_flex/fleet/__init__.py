"""Many robots of one make: the loop closed on each, what they have in common, and which of them stands out."""
