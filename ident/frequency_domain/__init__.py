"""Maximum likelihood on the Fourier transforms of whole records."""
