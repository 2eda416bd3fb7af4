import { useEffect, useState } from "preact/hooks";
import { type Job, fetchArtifact } from "meshmend-client";
import { weightOf } from "../report/files";
import { THICK_BAND, bandOf, leastWallOf } from "../report/wall-thickness";
import { server } from "../state/server";
import type { LegendEntry } from "../viewer/glb";
import { usePageWords } from "../words/page-locale";
import { Swatch, useLength } from "./layers";
import { Icon } from "./icons";
import type { Shown } from "./viewer-pane";

/** The wall thickness of the result in colours, drawn over it on request. */
export function ThicknessLayer({ job, shown }: { job: Job; shown: Shown | null }) {
  const { words, figures } = usePageWords();
  const { tell, own } = useLength(job);
  const [isOn, setOn] = useState(false);
  const [legend, setLegend] = useState<LegendEntry[] | null>(null);
  const [isMissing, setMissing] = useState(false);
  const artifact = job.artifacts["thickness.glb"];
  const leastWall = leastWallOf(job);
  const viewer = shown?.viewer ?? null;
  useEffect(() => {
    if (!isOn || legend || !viewer || !artifact) return;
    const stop = new AbortController();
    const load = async (): Promise<void> => {
      const { readColouredMesh } = await import("../viewer/mod");
      const mesh = readColouredMesh(await fetchArtifact(server, artifact, stop.signal));
      if (stop.signal.aborted) return;
      viewer.lay("after", mesh, "fine", (kind) => kind !== THICK_BAND);
      setLegend(mesh.legend.filter(({ kind, count }) => kind !== THICK_BAND && count > 0));
    };
    load().catch((error: unknown) => {
      if (stop.signal.aborted) return;
      console.warn("The wall thickness could not be read:", error);
      setMissing(true);
    });
    return () => stop.abort();
  }, [viewer, isOn]);
  useEffect(() => legend?.forEach(({ kind }) => viewer?.showKind(kind, isOn)), [viewer, legend, isOn]);
  if (!artifact || leastWall === null) return null;
  const band = (kind: string): string => {
    const { from, to } = bandOf(kind, leastWall) ?? { from: null, to: null };
    return [from, to].map((mm) => (mm === null ? "" : tell(own(mm)))).join(" – ");
  };
  return (
    <li class={isOn ? "layer thickness-layer" : "layer thickness-layer off"}>
      <button type="button" class="toggle" aria-pressed={isOn} disabled={!viewer} onClick={() => setOn(!isOn)}>
        <Swatch kind="thin_wall" colour="#de2d26" />
        <span class="name">{words.wallThickness}</span>
        <span class="count">{!legend && weightOf(job, "thickness.glb") > 0 ? figures.bytes(weightOf(job, "thickness.glb")) : ""}</span>
        <Icon name={isOn ? "eye" : "hidden"} size={16} />
      </button>
      {isOn && isMissing && <p class="more">{words.wallThicknessMissing}</p>}
      {isOn && legend?.length === 0 && <p class="more">{words.wallsAreThick(tell(own(leastWall)))}</p>}
      {isOn && legend && legend.length > 0 && (
        <ul class="more">
          {legend.map(({ kind, colour }) => (
            <li key={kind}>
              <Swatch kind="thin_wall" colour={colour} /> {band(kind)}
            </li>
          ))}
        </ul>
      )}
    </li>
  );
}
