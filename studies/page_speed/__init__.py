"""How fluid the operator's page is: rows that all change, large maps that are moved and enlarged, maps that come in meanwhile."""
