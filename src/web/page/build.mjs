// Builds the page into ../dist, which is committed so that the program builds without node.
//   node build.mjs           write it
//   node build.mjs --check   fail where what is committed is not what would be written
//   node build.mjs --test    run the unit tests
import { spawnSync } from "node:child_process";
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";
import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const dist = join(here, "..", "dist");

/** Options that the page, its development server and its tests share. */
export const options = {
  absWorkingDir: here,
  bundle: true,
  format: "esm",
  target: "es2022",
  jsx: "automatic",
  jsxImportSource: "preact",
  legalComments: "eof",
  logLevel: "warning",
};

/** The files of the page by name: the document, the frame of the documentation, and assets with a hash in their names. */
export async function bundle(minify = true) {
  const result = await build({
    ...options,
    entryPoints: { page: "src/page.tsx", style: "src/style/page.css", manual: "src/style/manual.css" },
    outdir: dist,
    entryNames: "[name]-[hash]",
    chunkNames: "[name]-[hash]",
    assetNames: "[name]-[hash]",
    loader: { ".svg": "file" },
    splitting: true,
    minify,
    write: false,
    metafile: true,
  });
  const files = new Map(result.outputFiles.map((file) => [file.path.slice(dist.length + 1), Buffer.from(file.contents)]));
  const named = (start, end) => [...files.keys()].find((name) => name.startsWith(start) && name.endsWith(end));
  const icon = readFileSync(join(here, "src/icon.svg"));
  const iconName = `icon-${createHash("sha256").update(icon).digest("hex").slice(0, 8).toUpperCase()}.svg`;
  files.set(iconName, icon);
  const written = (source, style) =>
    readFileSync(join(here, "src", source), "utf8")
      .replace("{style}", named(style, ".css"))
      .replace("{script}", named("page-", ".js"))
      .replace("{icon}", iconName);
  files.set("index.html", Buffer.from(written("index.html", "style-")));
  files.set("manual.html", Buffer.from(written("manual.html", "manual-")));
  return files;
}

/** What tells the program which files there are. */
function list(files) {
  const names = [...files.keys()].filter((name) => !name.endsWith(".html")).sort();
  const lines = names.map((name) => `    ("${name}", include_bytes!("${name}")),`);
  return [
    "// Written by build.mjs.",
    `pub(super) const DOCUMENT: &[u8] = include_bytes!("index.html");`,
    `pub(super) const MANUAL: &str = include_str!("manual.html");`,
    "#[rustfmt::skip]",
    `pub(super) const ASSETS: [(&str, &[u8]); ${names.length}] = [`,
    ...lines,
    "];",
    "",
  ].join("\n");
}

async function test() {
  const folder = join(here, ".build", "test");
  rmSync(folder, { recursive: true, force: true });
  const entryPoints = readdirSync(join(here, "test")).filter((name) => name.endsWith(".test.ts")).map((name) => `test/${name}`);
  await build({ ...options, entryPoints, outdir: folder, platform: "node", outExtension: { ".js": ".mjs" } });
  const tests = readdirSync(folder).map((name) => join(folder, name));
  process.exit(spawnSync(process.execPath, ["--test", ...tests], { stdio: "inherit" }).status ?? 1);
}

if (process.argv[1] === fileURLToPath(import.meta.url)) {
  if (process.argv.includes("--test")) await test();
  const files = await bundle();
  files.set("files.rs", Buffer.from(list(files)));
  if (process.argv.includes("--check")) {
    const there = readdirSync(dist).sort();
    const wanted = [...files.keys()].sort();
    const differs = (name) => !readFileSync(join(dist, name)).equals(files.get(name));
    if (there.join() !== wanted.join() || wanted.some(differs)) {
      console.error("src/web/dist is not what src/web/page makes: run `make page` and commit what it writes.");
      process.exit(1);
    }
  } else {
    rmSync(dist, { recursive: true, force: true });
    mkdirSync(dist, { recursive: true });
    for (const [name, bytes] of files) writeFileSync(join(dist, name), bytes);
  }
  let sum = 0;
  for (const [name, bytes] of files) {
    if (name === "files.rs") continue;
    const packed = gzipSync(bytes, { level: 9 }).length;
    sum += packed;
    console.log(`${name.padEnd(28)} ${String(bytes.length).padStart(8)} B ${String(packed).padStart(8)} B compressed`);
  }
  console.log(`${"together".padEnd(28)} ${" ".repeat(10)} ${String(sum).padStart(8)} B compressed`);
}
