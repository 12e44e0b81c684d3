"""A page that follows a watch in the browser of the same machine.

Events are sent as server-sent events (WHATWG HTML, 9.2): the browser comes back by itself and says
what it saw last. Python's standard library serves them; nothing is fetched from elsewhere.
"""
