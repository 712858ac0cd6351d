"""What suites measure on."""
