"""Designs of links: one page of answers for a system designer."""
