"""Every effect and every number of the machine file as columns of one linear regression."""
