"""Provoked against said: runs with a known fault, and what the loop made of them."""
