// Holds the manifests of KEDA's kinds against its schemas: node keda.mjs FILE...
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { loadAll } from "js-yaml";

const kinds = createRequire(import.meta.url)("@kubernetes-models/keda/keda.sh/v1alpha1");

let held = 0;
for (const file of process.argv.slice(2)) {
  for (const manifest of loadAll(readFileSync(file, "utf8"))) {
    if (!manifest?.apiVersion?.startsWith("keda.sh/")) continue;
    try {
      new kinds[manifest.kind](manifest).validate();
    } catch (error) {
      console.error(`${file}: ${manifest.kind} ${manifest.metadata?.name}: ${error.message}`);
      process.exit(1);
    }
    held += 1;
  }
}
if (held === 0) {
  console.error("no manifest of KEDA's kinds was found");
  process.exit(1);
}
