"""The library of effects: one file each in the folder of its station."""
