"""What many flights say together: common values, scatter between flights, effects that recur."""
