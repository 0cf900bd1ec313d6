"""A run in numbers: `recorder` takes what happens, `report` and `report_of_arms` sum it up."""
