-- What kind of tenant one is, in the operator's words, for the metrics; null is 'standard'.
ALTER TABLE tenants ADD COLUMN class TEXT;
