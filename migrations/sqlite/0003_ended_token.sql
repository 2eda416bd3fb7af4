-- Whose attempt ended last: a worker that did not hear whether its last write arrived can ask again.
ALTER TABLE jobs ADD COLUMN ended_token TEXT;
