-- Where the request that made a job stands in a trace (W3C Trace Context), for its worker to go on from.
ALTER TABLE jobs ADD COLUMN traceparent TEXT;
-- Jobs are counted by status each time the metrics are asked for, which reads no row with this.
CREATE INDEX jobs_kept ON jobs (status) WHERE purged_at IS NULL;
