// Repairs a model with the types of openapi-typescript. Arguments: the service's address, the model, where the result goes.
import { readFile, writeFile } from "node:fs/promises";
import createClient from "openapi-fetch";
import type { paths } from "./schema.js";

const [address, input, output] = process.argv.slice(2);
if (!address || !input || !output) throw new Error("three arguments are needed");

const client = createClient<paths>({ baseUrl: address });
const model = new File([new Uint8Array(await readFile(input))], "box.stl");
const submitted = await client.POST("/v1/jobs", {
  // openapi-typescript types binary parts as texts; the serializer sends the file.
  body: { file: [model.name], options: { mode: "repair", output: "stl" } },
  bodySerializer: (body) => {
    const form = new FormData();
    if (typeof body === "object" && "file" in body) form.append("options", JSON.stringify(body.options));
    form.append("file", model);
    return form;
  },
});
if (submitted.error) throw new Error(submitted.error.detail);
let job = submitted.data;
while (job.status === "queued" || job.status === "running") {
  const asked = await client.GET("/v1/jobs/{id}", { params: { path: { id: job.id }, query: { wait: 20 } } });
  if (asked.error) throw new Error(asked.error.detail);
  job = asked.data;
}
console.log(job.status, job.outcome);
const result = await client.GET("/v1/jobs/{id}/artifacts/{name}", {
  params: { path: { id: job.id, name: "model" } },
  parseAs: "arrayBuffer",
});
if (!result.data) throw new Error(JSON.stringify(result.error));
await writeFile(output, Buffer.from(result.data));
