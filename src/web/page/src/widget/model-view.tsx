import { useLayoutEffect, useRef, useState } from "preact/hooks";
import { type Artifact, type Job, type Server, fetchArtifact } from "meshmend-client";
import { isRemark, upOfJob } from "../report/summary";
import { claimsOf } from "../report/verdict";
import { colouredFiles } from "../state/colours";
import type { ColouredMesh } from "../viewer/glb";
import { pressed } from "../viewer/keys";
import type { Mode } from "../viewer/layout";
import type * as ViewerModule from "../viewer/mod";
import type { Viewer } from "../viewer/viewer";
import { Icon } from "../views/icons";
import { Picture } from "../views/picture";
import { Wipe } from "../views/wipe";
import { useWords } from "../words/locale";
import { ORIGIN } from "./origin";

/** Path of the viewer script; build.mjs defines it. */
declare const VIEWER: string;

const MODES: Mode[] = ["wipe", "before", "after"];

interface Props {
  job: Job;
  server: Server;
  /** The uploaded file, for its colours. */
  file: File | null;
  /** Called with the viewer once it shows the model. */
  shown: (viewer: Viewer | null) => void;
}

/** Both models in 3D, or without WebGL the pictures that the service drew. */
export function ModelView({ job, server, file, shown }: Props) {
  const { words } = useWords();
  const canvas = useRef<HTMLCanvasElement>(null);
  const over = useRef<HTMLDivElement>(null);
  const [viewer, setViewer] = useState<Viewer>();
  const [mode, setMode] = useState<Mode>("wipe");
  const [state, setState] = useState<"loading" | "ready" | "missing">("loading");
  const hasAfter = "change.glb" in job.artifacts;

  const model = job.artifacts["model"]?.href;
  // A layout effect ends in the same turn in which its canvas goes, so that a load that goes on never writes to a canvas that is gone.
  useLayoutEffect(() => {
    const stop = new AbortController();
    setState("loading");
    // Customers get the coarse preview of a large model, which is as small as a picture.
    const at = (name: string): Artifact | undefined => job.artifacts[`${name}-preview.glb`] ?? job.artifacts[`${name}.glb`];
    const load = async (): Promise<void> => {
      // A classic script from another origin has no base address, so the import needs the full URL.
      const { Viewer, readAppearance, readColouredMesh } = (await import(new URL(VIEWER, ORIGIN).href)) as typeof ViewerModule;
      const read = async (artifact: Artifact | undefined): Promise<ColouredMesh | null> =>
        artifact ? readColouredMesh(await fetchArtifact(server, artifact, stop.signal)) : null;
      const [before, change, remaining] = await Promise.all([read(at("defects")), read(at("change")), read(at("remaining"))]);
      if (stop.signal.aborted || !canvas.current || !over.current) return;
      const viewer = new Viewer(canvas.current, over.current, upOfJob(job));
      stop.signal.addEventListener("abort", () => viewer.dispose());
      viewer.setMode(mode);
      viewer.compare(before, change, "fine");
      // The result shows only the defects that the verdict mentions.
      if (remaining && !claimsOf(job).isPrintable) viewer.lay("after", remaining, "fine", (kind) => kind !== "sound" && !isRemark(kind));
      setViewer(viewer);
      shown(viewer);
      setState("ready");
      canvas.current.dataset["ready"] = "true";
      for (const { side, bytes } of colouredFiles(server, job, file, stop.signal)) {
        const appearance = await readAppearance(await bytes());
        if (stop.signal.aborted) return;
        if (appearance) viewer.setAppearance(side, appearance);
      }
      canvas.current.dataset["coloured"] = "true";
    };
    load().catch((error: unknown) => {
      if (stop.signal.aborted) return;
      console.warn("meshmend-upload cannot show 3D:", error);
      setState("missing");
    });
    return () => {
      stop.abort();
      shown(null);
    };
  }, [job.id, model]);

  if (state === "missing") {
    const result = job.artifacts["after.png"];
    return (
      <div class="look" part="view">
        <Picture artifact={result ?? job.artifacts["before.png"]} server={server} label={result ? words.after : words.before} />
      </div>
    );
  }
  const choose = (next: Mode): void => {
    setMode(next);
    viewer?.setMode(next);
  };
  return (
    <div class="look" part="view">
      <div class="look-bar">
        {hasAfter && (
          <div class="segments" role="group" aria-label={words.viewer}>
            {MODES.map((option) => (
              <button key={option} type="button" aria-pressed={mode === option} onClick={() => choose(option)}>
                {words.modes[option]}
              </button>
            ))}
          </div>
        )}
        <button type="button" class="quiet" title={words.home} aria-label={words.home} onClick={() => viewer?.home()}>
          <Icon name="home" />
        </button>
      </div>
      <div class="canvas-box">
        <canvas key={model} ref={canvas} tabIndex={0} role="img" aria-label={words.canvas(job.input.name)} title={words.viewerHelp} onKeyDown={(event) => pressed(viewer, event)} />
        <div class="over" ref={over}>
          {hasAfter && mode !== "after" && <span class="tag before">{words.before}</span>}
          {hasAfter && mode !== "before" && <span class="tag after">{words.after}</span>}
          {hasAfter && mode === "wipe" && <Wipe viewer={viewer ?? null} />}
        </div>
        {state === "loading" && (
          <p class="loading" role="status">
            <span class="spinner" /> {words.loading}
          </p>
        )}
      </div>
    </div>
  );
}
