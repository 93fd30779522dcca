"""Motions that a robot is identified from best: what they tell, what a robot can do, and the search among them."""
