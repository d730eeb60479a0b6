"""Judges programs from their text alone; shares nothing with the stages and posts that made them."""
