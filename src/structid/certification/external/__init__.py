"""External draws: the certificate of a posterior that another program drew."""
