"""Reports of an experiment: tables, statistics, figures and pages."""
