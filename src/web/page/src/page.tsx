import { render } from "preact";
import { meet } from "./state/server";
import { Page } from "./views/app";

render(<Page />, document.getElementById("page")!);
void meet();
