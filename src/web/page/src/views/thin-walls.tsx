import { useEffect, useMemo, useState } from "preact/hooks";
import type { Job, ThinPlace, ThinnestWall } from "meshmend-client";
import { fullReport } from "../state/job";
import { server } from "../state/server";
import { usePageWords } from "../words/page-locale";
import { GoThere, Swatch, useLength } from "./layers";
import { Icon } from "./icons";
import type { Shown } from "./viewer-pane";

/** The thinnest wall that most printers can print, in millimetres. */
const USUAL_MM = 0.8;
/** The service reports at most this many places. */
const MOST = 100;
const CHOICES_MM = [0.4, 0.8, 1.2, 2, 3];
export const THIN_COLOUR = "#e45fb4";

function wallOf(report: Job["report"]): ThinnestWall | null {
  if (report?.mode !== "repair") return null;
  return report.after?.print?.thinnest_wall ?? report.before.print?.thinnest_wall ?? null;
}

/** The thinnest wall of the job's model: first from the job, then from its full report, which lists all thin places. */
function useWall(job: Job): ThinnestWall | null {
  const [whole, setWhole] = useState<ThinnestWall | null>(null);
  useEffect(() => {
    setWhole(null);
    const stop = new AbortController();
    if (wallOf(job.report)) {
      fullReport(server, job, stop.signal).then(
        (report) => setWhole(wallOf(report)),
        (error: unknown) => stop.signal.aborted || console.warn("The thin walls could not be read:", error),
      );
    }
    return () => stop.abort();
  }, [job.id]);
  return whole ?? wallOf(job.report);
}

/** The layer of walls that are too thin for the chosen printer. */
export function ThinWalls({ job, shown }: { job: Job; shown: Shown | null }) {
  const { words, figures } = usePageWords();
  const { tell, own } = useLength(job);
  const [least, setLeast] = useState(USUAL_MM);
  const [isOn, setOn] = useState(true);
  const wall = useWall(job);
  const thin = useMemo((): ThinPlace[] => {
    const all = wall ? (wall.places ?? [{ at: wall.at, thickness: wall.thickness }]) : [];
    return all.filter(({ thickness }) => thickness < own(least));
  }, [wall, least]);
  useEffect(() => {
    shown?.viewer.setSpots("thin_wall", isOn ? thin.map(({ at }) => at) : [], THIN_COLOUR);
  }, [shown, thin, isOn]);
  if (!wall) return null;
  const [one, many] = words.kinds["thin_wall"]!;
  const name = thin.length === 1 ? one : many;
  const first = { at: wall.at, thickness: wall.thickness };
  const places = () => (thin.length > 0 ? thin : [first]).map(({ at }) => shown?.viewer.placeAt(at)).filter((place) => place != null);
  return (
    <li class={isOn ? "layer thin" : "layer thin off"}>
      <button type="button" class="toggle" aria-pressed={isOn} onClick={() => setOn(!isOn)}>
        <Swatch kind="thin_wall" colour={THIN_COLOUR} />
        <span class="count">{figures.count(thin.length)}
          {thin.length >= MOST && "+"}
        </span>
        <span class="name">{name}</span>
        <Icon name={isOn ? "eye" : "hidden"} size={16} />
      </button>
      <GoThere label={words.goThere(name)} places={places} shown={shown} key={least} />
      <p class="more">
        <label>
          {words.thinBelow}{" "}
          <select value={String(least)} onChange={(event) => setLeast(Number(event.currentTarget.value))}>
            {CHOICES_MM.map((mm) => (
              <option key={mm} value={String(mm)}>
                {tell(own(mm))}
              </option>
            ))}
          </select>
        </label>
        <span>{words.thinnest(tell(wall.thickness))}</span>
      </p>
    </li>
  );
}
