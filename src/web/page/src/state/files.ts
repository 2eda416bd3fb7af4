/** Extensions of model files, by format. Other files in a folder are skipped. */
const ENDINGS: Record<string, string[]> = {
  stl: ["stl"],
  obj: ["obj"],
  ply: ["ply"],
  off: ["off", "coff", "noff"],
  mesh: ["mesh", "txt"],
  "3mf": ["3mf"],
  glb: ["glb"],
};

export function endings(formats: readonly string[]): string[] {
  return formats.flatMap((format) => ENDINGS[format] ?? [format]);
}

export function isModel(name: string, formats: readonly string[]): boolean {
  const ending = name.toLowerCase().split(".").pop() ?? "";
  return endings(formats).includes(ending);
}

/** Most files per drop; larger batches should use the API. */
export const MOST_FILES = 200;

/** The dropped files, including files in folders. A single file is accepted whatever its name. */
export async function dropped(data: DataTransfer, formats: readonly string[]): Promise<File[]> {
  // The browser clears the entries at the first `await`, so they are read before.
  const entries = [...data.items].filter((item) => item.kind === "file").map((item) => item.webkitGetAsEntry());
  if (entries.every((entry) => entry === null)) return [...data.files];
  const files: File[] = [];
  for (const entry of entries) if (entry) await gather(entry, formats, files, true);
  return files;
}

async function gather(entry: FileSystemEntry, formats: readonly string[], files: File[], isOwn: boolean): Promise<void> {
  if (files.length >= MOST_FILES) return;
  if (entry.isFile) {
    if (!isOwn && !isModel(entry.name, formats)) return;
    files.push(await new Promise<File>((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, reject)));
    return;
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader();
  for (;;) {
    const some = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject));
    if (some.length === 0) return;
    for (const inner of some.sort((a, b) => a.name.localeCompare(b.name))) await gather(inner, formats, files, false);
  }
}
