import { MeshmendUpload } from "./element";

// A page may include the script twice.
if (!customElements.get("meshmend-upload")) customElements.define("meshmend-upload", MeshmendUpload);
