"""Pages to read: one model of a document, one template."""
