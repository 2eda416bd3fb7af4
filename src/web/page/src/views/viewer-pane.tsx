import { useLayoutEffect, useRef, useState } from "preact/hooks";
import { type Artifact, type Job, fetchArtifact } from "meshmend-client";
import { weightOf } from "../report/files";
import { isRemark, unitOfJob, upOfJob } from "../report/summary";
import { claimsOf } from "../report/verdict";
import { server } from "../state/server";
import { settings } from "../state/settings";
import { colouredFiles } from "../state/colours";
import type { ColouredMesh } from "../viewer/glb";
import { pressed } from "../viewer/keys";
import type { Mode } from "../viewer/layout";
import type { Viewer } from "../viewer/viewer";
import { usePageWords } from "../words/page-locale";
import { Pictures } from "./result";
import { Ruler } from "./ruler";
import { useStore } from "./use-store";
import { ViewerBar } from "./viewer-bar";
import { Wipe } from "./wipe";

/** Larger files are loaded on request; until then a coarse preview is shown. */
const LARGE = 60_000_000;

/** What is loaded, and what is still loading. */
export interface Shown {
  viewer: Viewer;
  before: ColouredMesh | null;
  change: ColouredMesh | null;
  remaining: ColouredMesh | null;
}

interface Props {
  job: Job;
  /** The uploaded file, if the page still has it. */
  file: File | null;
  shown: Shown | null;
  setShown: (shown: Shown | null) => void;
}

/** Both models on a canvas, with the viewer's tools. */
export function ViewerPane({ job, file, shown, setShown }: Props) {
  const { words, figures } = usePageWords();
  const canvas = useRef<HTMLCanvasElement>(null);
  const over = useRef<HTMLDivElement>(null);
  const box = useRef<HTMLElement>(null);
  const { unit } = useStore(settings);
  const [isMeasuring, setMeasuring] = useState(false);
  const [hasColours, setHasColours] = useState(false);
  const [mode, setMode] = useState<Mode>(() => (innerWidth < 700 ? "wipe" : "both"));
  const [state, setState] = useState<"loading" | "coarse" | "ready" | "missing">("loading");
  const weight = weightOf(job, "defects.glb") + weightOf(job, "change.glb");
  const [wanted, want] = useState(weight <= LARGE);
  const go = useRef<() => void>(() => undefined);

  const model = job.artifacts["model"]?.href;
  // A layout effect ends in the same turn in which its canvas goes, so that a load that goes on never writes to a canvas that is gone.
  useLayoutEffect(() => {
    const stop = new AbortController();
    setState("loading");
    const load = async (): Promise<void> => {
      const { Viewer, readAppearance, readColouredMesh } = await import("../viewer/mod");
      if (stop.signal.aborted || !canvas.current || !over.current) return;
      const viewer = new Viewer(canvas.current, over.current, upOfJob(job));
      stop.signal.addEventListener("abort", () => viewer.dispose());
      viewer.setMode(mode);
      const fetched = async (artifact: Artifact): Promise<ColouredMesh> => readColouredMesh(await fetchArtifact(server, artifact, stop.signal));
      const read = (artifact: Artifact | undefined): Promise<ColouredMesh | null> => {
        const mesh = artifact ? fetched(artifact) : Promise.resolve(null);
        // If one download fails, the others are not awaited.
        mesh.catch(() => undefined);
        return mesh;
      };
      const at = (name: string): Artifact | undefined => job.artifacts[name];
      const place = (before: ColouredMesh | null, change: ColouredMesh | null, level: "fine" | "coarse"): void => {
        if (!stop.signal.aborted) viewer.compare(before, change, level);
      };
      const remaining = read(at("remaining.glb"));
      if (at("defects-preview.glb")) {
        const [before, change] = await Promise.all([read(at("defects-preview.glb")), read(at("change-preview.glb") ?? at("change.glb"))]);
        place(before, change, "coarse");
        setShown({ viewer, before, change, remaining: await remaining });
        setState("coarse");
        if (!wanted) await new Promise<void>((resolve) => (go.current = resolve));
      }
      // The first loaded model is shown while the other is still loading.
      const [first, second] = [read(at("defects.glb")), read(at("change.glb"))];
      const before = await first;
      const change = await second;
      place(before, change, "fine");
      const rest = await remaining;
      // The result shows only the defects that the verdict mentions.
      if (rest && !claimsOf(job).isPrintable) viewer.lay("after", rest, "fine", (kind) => kind !== "sound" && !isRemark(kind));
      if (stop.signal.aborted) return;
      setShown({ viewer, before, change, remaining: rest });
      setState("ready");
      canvas.current.dataset["ready"] = "true";
      performance.mark("model-shown");
      for (const { side, bytes } of colouredFiles(server, job, file, stop.signal)) {
        const appearance = await readAppearance(await bytes());
        if (stop.signal.aborted) return;
        if (appearance && viewer.setAppearance(side, appearance)) setHasColours(true);
      }
      canvas.current.dataset["coloured"] = "true";
    };
    load().catch((error: unknown) => {
      if (stop.signal.aborted) return;
      console.error(error);
      setState("missing");
    });
    return () => {
      stop.abort();
      setShown(null);
    };
  }, [job.id, model]);

  const change = (next: Mode): void => {
    setMode(next);
    shown?.viewer.setMode(next);
  };
  const hasAfter = "change.glb" in job.artifacts;
  const loading = weight > 0 ? words.loadingModel(figures.bytes(weight)) : words.loading;
  if (state === "missing") {
    return (
      <div class="viewer">
        <p class="nothing">{words.viewerMissing}</p>
        <Pictures job={job} />
      </div>
    );
  }
  return (
    <section class="viewer" data-mode={hasAfter ? mode : "before"} aria-label={words.viewer} ref={box}>
      <ViewerBar shown={shown} mode={mode} setMode={change} hasAfter={hasAfter} box={box} unit={unitOfJob(job)} hasColours={hasColours} isMeasuring={isMeasuring} setMeasuring={setMeasuring} />
      {isMeasuring && shown && <Ruler viewer={shown.viewer} canvas={canvas} unit={unit} modelUnit={unitOfJob(job)} close={() => setMeasuring(false)} />}
      <div class="canvas-box">
        <canvas key={`${job.id} ${model}`} ref={canvas} tabIndex={0} role="img" aria-label={words.canvas(job.input.name)} title={words.viewerHelp} onKeyDown={(event) => pressed(shown?.viewer, event)} />
        <div class="over" ref={over}>
          {hasAfter && mode !== "after" && <span class="tag before">{words.before}</span>}
          {hasAfter && mode !== "before" && <span class="tag after">{words.after}</span>}
          {hasAfter && mode === "wipe" && <Wipe viewer={shown?.viewer ?? null} />}
        </div>
        {state === "loading" && (
          <p class="loading" role="status">
            <span class="spinner" /> {loading}
          </p>
        )}
        {state === "coarse" && (
          <p class="coarse" role="status">
            {wanted ? loading : words.coarse}
            {!wanted && (
              <button type="button" class="link" onClick={() => (want(true), go.current())}>
                {words.loadFine(figures.bytes(weight))}
              </button>
            )}
          </p>
        )}
      </div>
    </section>
  );
}
