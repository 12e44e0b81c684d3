"""Elastic modes condensed into rigid derivatives, and how flexible an aircraft is."""
