"""What a measured record goes through between its file and a fit."""
