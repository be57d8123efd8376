"""Vehicle sets: many views of many vehicles."""
