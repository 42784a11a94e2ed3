"""Which poses to visit and to use: closed configurations, selection with a certificate, planning."""
