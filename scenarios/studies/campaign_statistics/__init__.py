"""Whether the sigmas of a campaign's runs are right: coverage, scatter, NEES, NIS and the Cramer-Rao bound."""
