"""Pages to read: one model of a document, one template.

It may import `plots`, `terminal`, `files` and `ident.statistics`, `ident.flying_qualities`; no kind
of study. The page of a kind is a function beside it that returns a `Page`. A table refuses a number
without a unit. What runs in a page is `page.js` alone: its policy names the hashes of script and
style, so neither may stand anywhere else.
"""
