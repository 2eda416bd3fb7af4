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

/** The first of the names that begin and end so. */
const named = (files, start, end) => [...files.keys()].find((name) => name.startsWith(start) && name.endsWith(end));

/** Builds some entries and answers their files by name. */
async function made(entryPoints, minify, more = {}) {
  const { outputFiles } = await build({
    ...options,
    entryPoints,
    outdir: dist,
    entryNames: "[name]-[hash]",
    minify,
    write: false,
    ...more,
  });
  return new Map(outputFiles.map((file) => [file.path.slice(dist.length + 1), Buffer.from(file.contents)]));
}

/** Leaves the viewer out of the page: it is a file of its own, which the page and the widget load when there is something to see. */
const viewerApart = (file) => ({
  name: "viewer-apart",
  setup: (it) => it.onResolve({ filter: /\/viewer\/mod$/ }, () => ({ path: file, external: true })),
});

/** Gives an import of a style its text, for constructable style sheets. */
const styleAsText = (minify) => ({
  name: "style-as-text",
  setup: (it) =>
    it.onLoad({ filter: /\.css$/ }, async ({ path }) => {
      const { outputFiles } = await build({ ...options, entryPoints: [path], minify, write: false });
      // A shop's root may have any size of letters, so lengths are told in the widget's own.
      const contents = outputFiles[0].text.replace(/(?<![\w.])(-?\d*\.?\d+)rem\b/g, "calc($1*var(--rem))");
      return { contents, loader: "text" };
    }),
});

/** The files of the page by name: the document, the widget, and assets with a hash in their names. */
export async function bundle(minify = true) {
  const files = await made({ viewer: "src/viewer/mod.ts" }, minify);
  const viewer = `/assets/${named(files, "viewer-", ".js")}`;
  for (const file of await made({ page: "src/page.tsx", style: "src/style/page.css", manual: "src/style/manual.css" }, minify, { plugins: [viewerApart(viewer)] })) files.set(...file);
  // A plain script, which pages load with or without `type="module"`.
  const plain = { format: "iife", entryNames: "[name]", define: { VIEWER: JSON.stringify(viewer) }, plugins: [styleAsText(minify)] };
  const widget = await made({ widget: "src/widget/widget.ts" }, minify, plain);
  for (const file of widget) files.set(...file);
  const icon = readFileSync(join(here, "src/icon.svg"));
  const iconName = `icon-${createHash("sha256").update(icon).digest("hex").slice(0, 8).toUpperCase()}.svg`;
  files.set(iconName, icon);
  const written = (source, style) =>
    readFileSync(join(here, "src", source), "utf8")
      .replace("{style}", named(files, style, ".css"))
      .replace("{script}", named(files, "page-", ".js"))
      .replace("{icon}", iconName);
  files.set("index.html", Buffer.from(written("index.html", "style-")));
  files.set("manual.html", Buffer.from(written("manual.html", "manual-")));
  return files;
}

/** Files whose names stay, as the program calls them. */
const STABLE = { "index.html": "DOCUMENT", "manual.html": "MANUAL", "widget.js": "WIDGET" };

/** What tells the program which files there are. */
function list(files) {
  const names = [...files.keys()].filter((name) => !(name in STABLE)).sort();
  const lines = names.map((name) => `    ("${name}", include_bytes!("${name}")),`);
  return [
    "// Written by build.mjs.",
    ...Object.entries(STABLE).map(([name, constant]) => `pub(super) const ${constant}: &str = include_str!("${name}");`),
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
