"""Closing the loop: what measured data still holds, which effect explains it, and what is left."""
