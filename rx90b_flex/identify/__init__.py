"""Identification of robots from measured motion."""
