"""Commands on flights that have not been flown."""
