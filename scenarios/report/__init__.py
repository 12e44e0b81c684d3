"""Reports: one typed document of a result, shown on a terminal, as a page and as JSON.

It may import `files` and `ident`; no kind of study. The document of a kind is a function beside it.
A table refuses a number without a unit. What runs in a page is `page.js` alone: its policy names
the hashes of script and style, so neither may stand anywhere else.
"""
