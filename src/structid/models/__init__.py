"""Models: from parameters and an excitation to response histories."""
