"""What `import flightid` offers: records in memory, results with values, tables and figures."""
