"""Reports: one typed document of a result, shown on a terminal, as a page and as JSON.

It may import `files` and `ident`, but no kind of study. Each kind of study has a function that
makes its document.
A table refuses a number without a unit. The only script of a page is `page.js`: the page's
security policy has the hashes of script and style.
"""
