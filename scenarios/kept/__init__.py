"""The model of a study, kept in its folder so that it can predict other records later."""
