"""What the paper's experiments share: jobs that resume, measurements, statistics, tables, plots."""
