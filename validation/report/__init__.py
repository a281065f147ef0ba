"""The report: one page that shows every comparison."""
