-- Where the request that made a job stands in a trace (W3C Trace Context), for its worker to go on from.
ALTER TABLE jobs ADD COLUMN traceparent TEXT;
