import { useEffect, useMemo, useState } from "preact/hooks";
import type { Job } from "meshmend-client";
import { type Family, isShownAtFirst, styleOf } from "../viewer/kind-styles";
import type { Place } from "../viewer/places";
import { inMillimetres } from "../units";
import { settings } from "../state/settings";
import { unitOfJob } from "../report/summary";
import { claimsOf } from "../report/verdict";
import { usePageWords } from "../words/page-locale";
import { Icon } from "./icons";
import { ThicknessLayer } from "./thickness-layer";
import { ThinWalls } from "./thin-walls";
import { useStore } from "./use-store";
import type { Shown } from "./viewer-pane";

/** A row of the legend. */
export interface Layer {
  kind: string;
  colour: string;
  count: number;
  /** Whether the row belongs to the result instead of the input. */
  isAfter: boolean;
}

const FAMILIES: Family[] = ["open", "non_manifold", "crossing", "flipped", "needless"];
const CHANGES = ["removed", "added", "moved"];

export function layersOf(shown: Shown | null): Layer[] {
  if (!shown) return [];
  const found = (shown.before?.legend ?? []).map((entry) => ({ ...entry, isAfter: false }));
  const changed = (shown.change?.legend ?? []).filter(({ kind }) => CHANGES.includes(kind));
  const order = changed.sort((a, b) => CHANGES.indexOf(a.kind) - CHANGES.indexOf(b.kind)).map((entry) => ({ ...entry, isAfter: true }));
  return [...found, ...order].filter(({ count }) => count > 0);
}

/** Every kind of defect or change: colour and pattern, count, and buttons to its places. */
export function Layers({ job, shown }: { job: Job; shown: Shown | null }) {
  const { words } = usePageWords();
  const layers = useMemo(() => layersOf(shown), [shown]);
  const found = new Set(layers.map(({ kind }) => styleOf(kind).family));
  // If the deadline passed before the inspection, no defects were searched for.
  const isInspected = job.report?.mode === "repair" && job.report.before.level !== "none";
  const clean = isInspected ? FAMILIES.filter((family) => !found.has(family)) : [];
  return (
    <section class="layers">
      <h2>{words.layers}</h2>
      {shown && layers.length === 0 && claimsOf(job).isPrintable && <p class="clean">{words.layersNone}</p>}
      <ul>
        {layers.map((layer) => (
          <LayerRow key={layer.kind} layer={layer} shown={shown} />
        ))}
        <ThinWalls job={job} shown={shown} />
        <ThicknessLayer job={job} shown={shown} />
      </ul>
      {shown && clean.length > 0 && (
        <p class="clean">
          {words.layersClean}: {clean.map((family) => words.families[family]).join(", ")}
        </p>
      )}
    </section>
  );
}

function LayerRow({ layer, shown }: { layer: Layer; shown: Shown | null }) {
  const { words, figures } = usePageWords();
  const [isOn, setOn] = useState(isShownAtFirst(layer.kind));
  const viewer = shown?.viewer;
  useEffect(() => viewer?.showKind(layer.kind, isOn), [viewer, layer.kind, isOn]);
  const [one, many] = words.kinds[layer.kind] ?? [layer.kind, layer.kind];
  const name = layer.count === 1 ? one : many;
  const places = (): Place[] => {
    setOn(true);
    return viewer?.places(layer.kind) ?? [];
  };
  return (
    <li class={isOn ? "layer" : "layer off"}>
      <button type="button" class="toggle" aria-pressed={isOn} onClick={() => setOn(!isOn)}>
        <Swatch kind={layer.kind} colour={layer.colour} />
        <span class="count">{figures.count(layer.count)}</span>
        <span class="name">{name}</span>
        <Icon name={isOn ? "eye" : "hidden"} size={16} />
      </button>
      <GoThere label={words.goThere(name)} places={places} shown={shown} />
    </li>
  );
}

/** Moves the camera to the first place, then from place to place. */
export function GoThere({ label, places, shown }: { label: string; places: () => Place[]; shown: Shown | null }) {
  const { words, figures } = usePageWords();
  const [at, setAt] = useState<{ i: number; of: Place[] } | null>(null);
  useEffect(() => setAt(null), [shown]);
  const go = (): void => {
    const of = at?.of ?? places();
    if (of.length === 0) return;
    const i = at ? (at.i + 1) % of.length : 0;
    shown?.viewer.visit(of[i]!);
    setAt({ i, of });
  };
  return (
    <button type="button" class="go" title={label} aria-label={label} onClick={go} disabled={!shown}>
      <Icon name="target" size={16} />
      <span class="nth" aria-live="polite">
        {at ? words.placeOf(at.i + 1, at.of.length).replace(/\d+/g, (n) => figures.count(Number(n))) : ""}
      </span>
    </button>
  );
}

/** A sample of a layer's colour and pattern, as in the viewer. */
export function Swatch({ kind, colour }: { kind: string; colour: string }) {
  return <span class={`swatch ${styleOf(kind).pattern}`} style={{ backgroundColor: colour }} />;
}

/** The unit of a job's model in millimetres. */
export function useLength(job: Job): { tell: (own: number) => string; own: (mm: number) => number } {
  const { figures } = usePageWords();
  const { unit } = useStore(settings);
  const factor = inMillimetres(unitOfJob(job));
  return { tell: (length) => figures.length(length * factor, unit, 3), own: (mm) => mm / factor };
}
