"""External draws: certificate of a posterior that another program sampled."""
