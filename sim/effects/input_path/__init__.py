"""Effects between the recorded input and the vehicle, one file for an effect or a family.

``act(edges, u, p)`` works on cell means, ordered by ``path_order``, the place on the path; a state
form (``rates``, ``pass_on``) lets filters take the effect. No file imports another effect.
"""
