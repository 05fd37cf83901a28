"""Network side of the host: the gateway process, access rights and TLS."""
