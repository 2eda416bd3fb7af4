import { useEffect, useState } from "preact/hooks";
import type { Job, Options, PrintReadiness } from "meshmend-client";
import { isRepair, optionsOf } from "../report/advice";
import { readinessIn, readinessOf, readinessOfFiles, withProcess } from "../report/print-ready";
import { fullReport } from "../state/job";
import { server } from "../state/server";
import { choose } from "../state/settings";
import { usePageWords } from "../words/page-locale";
import { GoThere } from "./layers";
import { PrintReady, type GoTo } from "./print-ready";
import { ProcessSelect } from "./process-select";
import type { Shown } from "./viewer-pane";

/** The colour of places that break a rule. */
const COLOUR = "#d9480f";

/** The readiness of the job's file: first from the job, then from its full report, which lists more places. */
function useReadiness(job: Job): PrintReadiness | null {
  const [whole, setWhole] = useState<PrintReadiness | null>(null);
  useEffect(() => {
    setWhole(null);
    const stop = new AbortController();
    if (readinessOf(job)) {
      fullReport(server, job, stop.signal).then(
        (report) => setWhole(readinessIn(report)),
        (error: unknown) => stop.signal.aborted || console.warn("The places of the rules could not be read:", error),
      );
    }
    return () => stop.abort();
  }, [job.id]);
  return whole ?? readinessOf(job);
}

/** The rules of the job's process with their places in the viewer, and a choice of another process. */
export function ProcessCheck({ job, shown, retry }: { job: Job; shown: Shown | null; retry: (options: Options) => void }) {
  const { words } = usePageWords();
  const readiness = useReadiness(job);
  useEffect(() => {
    const places = readiness?.rules.flatMap((rule) => rule.places ?? []) ?? [];
    shown?.viewer.setSpots("print_rules", places.map(({ at }) => at), COLOUR);
  }, [shown, readiness]);
  const goTo: GoTo = (name, points) => {
    if (points.length === 0 || !shown) return null;
    const places = () => points.map((at) => shown.viewer.placeAt(at)).filter((place) => place != null);
    return <GoThere label={words.goThere(name)} places={places} shown={shown} />;
  };
  if (job.status === "expired" || !job.report) return null;
  if (!isRepair(job)) return <AnalysedFiles job={job} goTo={goTo} />;
  const change = (process: string): void => {
    choose({ process });
    retry(withProcess(optionsOf(job), process));
  };
  return (
    <section class="process-check">
      {readiness && <PrintReady job={job} readiness={readiness} retry={retry} goTo={goTo} />}
      <ProcessSelect value={String(optionsOf(job)["process"] ?? "")} set={change} label={readiness ? words.otherProcess : words.checkProcess} />
    </section>
  );
}

/** The rules of the process for each file of an analysis. Places are shown for a single file, whose model the viewer has. */
function AnalysedFiles({ job, goTo }: { job: Job; goTo: GoTo }) {
  const files = readinessOfFiles(job.report ?? null);
  if (files.length === 0) return null;
  const isOnly = files.length === 1 && !job.inputs;
  return (
    <section class="process-check">
      {files.map(({ name, readiness }, number) => (
        <PrintReady key={number} job={job} readiness={readiness} name={files.length > 1 ? name : undefined} goTo={isOnly ? goTo : undefined} />
      ))}
    </section>
  );
}
