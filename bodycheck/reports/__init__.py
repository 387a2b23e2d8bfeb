"""The comparison layer: drift and error measures, orders and verdicts, then tables and the report."""
