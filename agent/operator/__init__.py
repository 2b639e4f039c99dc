"""An operator's words to the agents of this host, and the socket that carries them."""
