import type { Capabilities } from "meshmend-client";
import { brokenSample } from "../sample";
import { choose, settings } from "../state/settings";
import { usePageWords } from "../words/page-locale";
import { ChooseFiles } from "./choose-files";
import { Icon } from "./icons";
import { ProcessSelect } from "./process-select";
import { useStore } from "./use-store";

/** The start view: a short description and the drop zone. */
export function Dropzone({ can, over, take }: { can: Capabilities | null; over: boolean; take: (files: File[]) => void }) {
  const { words, figures } = usePageWords();
  const { process } = useStore(settings);
  const limits = can?.limits;
  const formats = can?.input_formats.map((format) => format.toUpperCase()).join(", ") ?? "";
  return (
    <section class="hero">
      <h1>{words.hero}</h1>
      <p class="lead">{words.heroMore}</p>
      <div class={over ? "dropzone over" : "dropzone"}>
        <Shape />
        <p class="big">{over ? words.letGo : words.dropHere}</p>
        <p class="small">{words.orChoose}</p>
        <ChooseFiles can={can} take={take} />
        <button type="button" class="link" onClick={() => take([brokenSample()])}>
          <Icon name="sparkle" size={16} /> {words.trySample}
        </button>
      </div>
      <ProcessSelect value={process} set={(process) => choose({ process })} label={words.checkProcess} />
      <p class="limits">{limits ? words.accepts(formats, figures.bytes(limits.max_bytes), figures.count(limits.max_file_faces)) : "\u00a0"}</p>
      <p class="limits">{words.privacy}</p>
    </section>
  );
}

/** An illustration: a mesh with a hole being closed. */
function Shape() {
  return (
    <svg class="shape" viewBox="0 0 160 96" width="160" height="96" aria-hidden="true" focusable="false">
      <path class="face" d="M80 6 120 26 80 46 40 26zM40 26 80 46 62 74 22 54zM120 26 138 54 98 74 80 46z" />
      <path class="gap" d="M80 46 98 74 80 90 62 74z" />
      <path class="face" d="M22 54 62 74 80 90 36 78zM138 54 124 78 80 90 98 74z" />
      <circle class="dot" cx="80" cy="46" r="3.2" />
      <circle class="dot" cx="98" cy="74" r="3.2" />
      <circle class="dot" cx="80" cy="90" r="3.2" />
      <circle class="dot" cx="62" cy="74" r="3.2" />
    </svg>
  );
}
