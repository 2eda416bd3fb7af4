-- With the id, the last of many jobs with one fingerprint is found without sorting them.
DROP INDEX jobs_reusable;
CREATE INDEX jobs_reusable ON jobs (tenant, fingerprint, id) WHERE status = 'succeeded' AND purged_at IS NULL;
