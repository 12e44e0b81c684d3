"""Repeated work: numbered tasks with seeds of their own, run by one process, by many, or by a cluster, and kept as they end."""
