-- When a worker last claimed a job. Tenants take turns by their last claim; started_at is only the first of each job.
ALTER TABLE jobs ADD COLUMN claimed_at INTEGER;
UPDATE jobs SET claimed_at = started_at WHERE started_at IS NOT NULL;
DROP INDEX jobs_served;
CREATE INDEX jobs_served ON jobs (tenant, claimed_at);
