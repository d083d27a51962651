"""Models, which compute response histories from parameters and an excitation."""
