/** Files that unpack to more bytes are not read. */
const MOST_BYTES = 300_000_000;
const [END, ENTRY] = [0x06054b50, 0x02014b50];

/** The files of a ZIP archive, unpacked on demand (PKWARE APPNOTE 6.3, without ZIP64). */
export class ZipArchive {
  readonly #entries = new Map<string, { method: number; at: number; packed: number; size: number }>();
  readonly #view: DataView;

  constructor(readonly bytes: Uint8Array) {
    this.#view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    let end = bytes.length - 22;
    while (end >= 0 && this.#view.getUint32(end, true) !== END) end -= 1;
    if (end < 0) throw new Error("the archive has no list of files");
    let at = this.#view.getUint32(end + 16, true);
    for (let left = this.#view.getUint16(end + 10, true); left > 0; left -= 1) {
      if (this.#view.getUint32(at, true) !== ENTRY) throw new Error("the archive's list of files is damaged");
      const [name, extra, comment] = [28, 30, 32].map((offset) => this.#view.getUint16(at + offset, true));
      const path = new TextDecoder().decode(bytes.subarray(at + 46, at + 46 + name!));
      const [packed, size] = [this.#view.getUint32(at + 20, true), this.#view.getUint32(at + 24, true)];
      this.#entries.set(path, { method: this.#view.getUint16(at + 10, true), at: this.#view.getUint32(at + 42, true), packed, size });
      at += 46 + name! + extra! + comment!;
    }
  }

  get names(): string[] {
    return [...this.#entries.keys()];
  }

  /** Finds a file by its path or the end of its path, case-insensitively. */
  async read(path: string): Promise<Uint8Array | null> {
    const wanted = path.replaceAll("\\", "/").replace(/^\.?\//, "").toLowerCase();
    const name = this.names.find((other) => other.toLowerCase() === wanted) ?? this.names.find((other) => other.toLowerCase().endsWith(`/${wanted.split("/").pop()}`));
    const entry = name === undefined ? undefined : this.#entries.get(name);
    if (!entry || entry.size > MOST_BYTES) return null;
    const start = entry.at + 30 + this.#view.getUint16(entry.at + 26, true) + this.#view.getUint16(entry.at + 28, true);
    const packed = this.bytes.subarray(start, start + entry.packed);
    if (entry.method === 0) return packed;
    if (entry.method !== 8) return null;
    const stream = new Blob([packed.slice()]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }
}
