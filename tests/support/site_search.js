// Answers of a built site's own search, as JSON: node site_search.js SITE QUERY ...
const fs = require("fs");
const path = require("path");
const vm = require("vm");

const [site, ...queries] = process.argv.slice(2);
const folder = path.join(site, "assets/javascripts/workers");
const worker = fs.readdirSync(folder).find((name) => /^search.*\.js$/.test(name));
let answer;
let listener;
const scope = {
  console,
  postMessage: (message) => answer(message),
  addEventListener: (_, found) => (listener = found),
};
scope.self = scope;
vm.runInNewContext(fs.readFileSync(path.join(folder, worker), "utf8"), scope);
const asked = (type, data) =>
  new Promise((resolve) => {
    answer = resolve;
    listener({ data: { type, data } });
  });
(async () => {
  const index = JSON.parse(fs.readFileSync(path.join(site, "search/search_index.json"), "utf8"));
  await asked(0, { ...index, options: { suggest: false } });
  const results = {};
  for (const query of queries) {
    const { data } = await asked(2, query);
    results[query] = data.items.map((sections) => sections.map((one) => one.location));
  }
  console.log(JSON.stringify(results));
})();
