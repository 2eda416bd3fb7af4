-- A job may have several files, each with its key: one list takes the place of the single file. What a job is to do,
-- and the account of it, say their mode.
ALTER TABLE jobs ADD COLUMN inputs TEXT NOT NULL DEFAULT '[]';   -- list of jobs::Input
UPDATE jobs SET inputs = json_array(json_set(input, '$.key', input_key)),
                options = json_set(options, '$.mode', 'repair'),
                report = json_set(report, '$.mode', 'repair');   -- null stays null
ALTER TABLE jobs DROP COLUMN input;
ALTER TABLE jobs DROP COLUMN input_key;
