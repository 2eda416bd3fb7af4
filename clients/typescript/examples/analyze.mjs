// Lists the defects of models without a repair: node analyze.mjs http://127.0.0.1:8080 a.stl b.stl
import { Client } from "meshmend-client";
import { fileAt } from "meshmend-client/node";

const [address, ...paths] = process.argv.slice(2);
const job = await new Client(address).analyze(await Promise.all(paths.map(fileAt)));
for (const file of job.report.files) {
  const found = file.inspection.defects.map(({ count, kind }) => `${count} ${kind}`);
  console.log(`${file.name}: ${file.printable ? "printable" : "not printable"}`, ...found);
}
