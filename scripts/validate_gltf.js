// What the Khronos validator finds in a GLB, in one line; fails unless it finds neither errors nor warnings.
const { readFileSync } = require("fs");
const { validateBytes } = require("gltf-validator");

const file = process.argv[2];
validateBytes(new Uint8Array(readFileSync(file)), { maxIssues: 20 }).then(({ issues, info }) => {
  const count = `${issues.numErrors} errors, ${issues.numWarnings} warnings, ${issues.numInfos} infos, ${issues.numHints} hints`;
  console.log(`validator  ${file.split("/").pop()}: ${count} (${info.animationCount} animation, ${info.totalVertexCount} vertices)`);
  for (const { code, message, pointer } of issues.messages.filter((m) => m.severity < 2)) {
    console.log(`  ${code} ${pointer}: ${message}`);
  }
  process.exitCode = issues.numErrors + issues.numWarnings === 0 ? 0 : 1;
});
