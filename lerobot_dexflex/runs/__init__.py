"""What everything that runs long shares: jobs in workers, rows on disk, versions, locks, statistics."""
