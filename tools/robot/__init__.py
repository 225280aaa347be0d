"""A robot that is not there: a log, published as a robot publishes, over a link that behaves badly to order."""
