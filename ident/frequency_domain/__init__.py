"""Maximum likelihood on the Fourier transforms of whole records, and on-line equation error."""
