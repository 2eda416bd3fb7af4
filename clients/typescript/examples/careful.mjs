// Repairs a model with a key, progress, limits and handling of every error.
import { Client, JobFailed, Problem } from "meshmend-client";
import { fileAt, save } from "meshmend-client/node";

const [address, broken, repaired] = process.argv.slice(2);
const client = new Client(address, { key: process.env.MESHMEND_API_KEY });
try {
  const job = await client.repair(await fileAt(broken), { max_tier: 2 }, {
    onProgress: ({ stage, percent }) => console.error(`${stage ?? "waiting"} ${percent} %`),
    timeout: 5 * 60_000,
    metadata: { order: "1234" },
  });
  console.log(job.outcome);
  if (job.artifacts.model) await save(client, job, repaired);
} catch (error) {
  if (error instanceof Problem) console.error(`refused: ${error.code}: ${error.detail} (request ${error.requestId})`);
  else if (error instanceof JobFailed) console.error(`failed: ${error.job.problem?.code}: ${error.message}`);
  else if (error.name === "TimeoutError") console.error("timeout: the job was canceled");
  else throw error;
  process.exitCode = 1;
}
