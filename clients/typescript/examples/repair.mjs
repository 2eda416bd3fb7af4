// Repairs a model: node repair.mjs http://127.0.0.1:8080 broken.off repaired.stl
import { Client, isPrintable } from "meshmend-client";
import { fileAt, save } from "meshmend-client/node";

const [address, broken, repaired] = process.argv.slice(2);
const client = new Client(address);
const job = await client.repair(await fileAt(broken), { output: "stl" });
console.log(`${job.outcome}: ${job.report.summary}`);
if (isPrintable(job)) await save(client, job, repaired);
