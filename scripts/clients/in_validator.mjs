// Khronos' validator of glTF on a file, its report as JSON on stdout.
//
//     node in_validator.mjs NODE_MODULES FILE.glb
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join } from "node:path";

const [modules, path] = process.argv.slice(2);
const validator = createRequire(join(modules, "x.js"))("gltf-validator");
const report = await validator.validateBytes(new Uint8Array(readFileSync(path)));
// it has no rules for the extensions of VRM, and says so
const issues = report.issues.messages.filter((one) => one.code !== "UNSUPPORTED_EXTENSION");
process.stdout.write(JSON.stringify({ version: validator.version(), issues }));
