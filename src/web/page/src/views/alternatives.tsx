import type { Alternative, Job, Server } from "meshmend-client";
import { choicesOf, pictureOf } from "../report/alternatives";
import type { Unit } from "../units";
import { useWords } from "../words/locale";
import { Picture } from "./picture";

interface Props {
  job: Job;
  server: Server;
  unit: Unit;
  /** The id of the chosen result. */
  choice: string;
  choose: (choice: string) => void;
  heading?: "h2" | "h3";
}

/** The results to choose from, where the file leaves the model's intent open: a picture and the numbers of each. */
export function Alternatives({ job, server, unit, choice, choose, heading: Heading = "h2" }: Props) {
  const { words } = useWords();
  const offered = choicesOf(job);
  if (offered.length === 0) return null;
  return (
    <fieldset class="alternatives">
      <Heading>{words.whichOne}</Heading>
      <p class="aside">{words.whichOneMore}</p>
      <div class="choices">
        {offered.map((alternative) => (
          <label key={alternative.id} class={alternative.id === choice ? "choice chosen" : "choice"}>
            <input type="radio" name={`choice-${job.id}`} checked={alternative.id === choice} onChange={() => choose(alternative.id)} />
            <Picture key={alternative.id} artifact={pictureOf(job, alternative.id)} server={server} label={null} />
            <strong>{alternative.is_default ? words.choiceDefault : (words.choices[alternative.option ?? ""] ?? alternative.detail)}</strong>
            <Figures alternative={alternative} unit={unit} />
          </label>
        ))}
      </div>
    </fieldset>
  );
}

/** Volume, weight, size and parts of one result. */
function Figures({ alternative, unit }: { alternative: Alternative; unit: Unit }) {
  const { words, figures } = useWords();
  const { volume_mm3: volume, thinnest_wall_mm: wall, weight_g: weight, size_mm: size, parts, printable } = alternative;
  return (
    <span class="aside">
      {volume != null && <span>{figures.volume(volume, unit)}</span>}
      {weight != null && <span>{figures.number(weight, 3)} g</span>}
      {size && <span>{figures.box(size, unit)}</span>}
      {wall != null && <span>{words.measures.thinnest}: {figures.length(wall, unit, 3)}</span>}
      <span>{words.partCount(parts)}</span>
      {!printable && <span class="wrong">{words.choiceNotPrintable}</span>}
    </span>
  );
}
