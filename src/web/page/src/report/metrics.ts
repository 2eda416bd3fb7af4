/** One line of metrics in Prometheus' text format. */
interface Sample {
  name: string;
  labels: Record<string, string>;
  value: number;
}

/** Parses the metrics that the page shows; skips lines that it cannot parse. */
export function readMetrics(text: string): Sample[] {
  const samples: Sample[] = [];
  for (const line of text.split("\n")) {
    const [, name, labels = "", value] = /^([a-zA-Z_:][\w:]*)(?:\{(.*)\})?\s+(\S+)/.exec(line) ?? [];
    if (!name || value === undefined) continue;
    const pairs = [...labels.matchAll(/(\w+)="((?:[^"\\]|\\.)*)"/g)].map(([, key, text]) => [key!, text!]);
    samples.push({ name, labels: Object.fromEntries(pairs) as Record<string, string>, value: Number(value) });
  }
  return samples;
}

/** The value of a metric, summed over unspecified labels; null if it is missing or not a number. */
export function valueOf(samples: Sample[], name: string, labels: Record<string, string> = {}): number | null {
  const fits = samples.filter((sample) => sample.name === name && Object.entries(labels).every(([key, value]) => sample.labels[key] === value));
  const sum = fits.reduce((sum, sample) => sum + sample.value, 0);
  return fits.length > 0 && Number.isFinite(sum) ? sum : null;
}
