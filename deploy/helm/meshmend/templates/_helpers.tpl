{{/* The name of all objects. */}}
{{- define "meshmend.name" -}}
{{- .Values.fullnameOverride | default .Release.Name | trunc 40 | trimSuffix "-" -}}
{{- end -}}

{{/* The labels that select pods: {root, component}; without a component, all pods of the release. */}}
{{- define "meshmend.selector" -}}
app.kubernetes.io/name: meshmend
app.kubernetes.io/instance: {{ .root.Release.Name }}
{{- with .component }}
app.kubernetes.io/component: {{ . }}
{{- end }}
{{- end -}}

{{/* The labels of an object: {root, component}. */}}
{{- define "meshmend.labels" -}}
{{ include "meshmend.selector" . }}
app.kubernetes.io/version: {{ .root.Chart.AppVersion | quote }}
app.kubernetes.io/managed-by: {{ .root.Release.Service }}
helm.sh/chart: {{ printf "%s-%s" .root.Chart.Name .root.Chart.Version }}
{{- end -}}

{{/* The name of the secret. */}}
{{- define "meshmend.secret" -}}
{{- .Values.secret.name | default (include "meshmend.name" .) -}}
{{- end -}}

{{/* What all pods have in common: {root}. */}}
{{- define "meshmend.pod" -}}
automountServiceAccountToken: false
# Service variables would begin with MESHMEND_ like the program's own, and unknown ones are refused.
enableServiceLinks: false
{{- with .root.Values.image.pullSecrets }}
imagePullSecrets:
  {{- range . }}
  - name: {{ . }}
  {{- end }}
{{- end }}
securityContext:
  runAsNonRoot: true
  runAsUser: 10001
  runAsGroup: 10001
  fsGroup: 10001
  fsGroupChangePolicy: OnRootMismatch
  seccompProfile: {type: RuntimeDefault}
{{- end -}}

{{/* What all containers have in common: {root}. */}}
{{- define "meshmend.container" -}}
image: {{ printf "%s:%s" .root.Values.image.repository (.root.Values.image.tag | default .root.Chart.AppVersion) }}
{{- with .root.Values.image.pullPolicy }}
imagePullPolicy: {{ . }}
{{- end }}
envFrom:
  - configMapRef: {name: {{ include "meshmend.name" .root }}}
  - secretRef: {name: {{ include "meshmend.secret" .root }}}
securityContext:
  allowPrivilegeEscalation: false
  readOnlyRootFilesystem: true
  capabilities: {drop: [ALL]}
volumeMounts:
  - {name: data, mountPath: /data}
  - {name: tmp, mountPath: /tmp}
{{- end -}}

{{/* The two writable folders: {data, tmp}. */}}
{{- define "meshmend.volumes" -}}
volumes:
  - name: data
    emptyDir: {sizeLimit: {{ .data }}}
  - name: tmp
    emptyDir: {sizeLimit: {{ .tmp }}}
{{- end -}}

{{/* Where a component's pods run: {root, component, of}. */}}
{{- define "meshmend.placement" -}}
topologySpreadConstraints:
  - maxSkew: 1
    topologyKey: kubernetes.io/hostname
    whenUnsatisfiable: ScheduleAnyway
    labelSelector:
      matchLabels:
        {{- include "meshmend.selector" . | nindent 8 }}
{{- with .of.nodeSelector }}
nodeSelector:
  {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .of.tolerations }}
tolerations:
  {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .of.affinity }}
affinity:
  {{- toYaml . | nindent 2 }}
{{- end }}
{{- end -}}

{{/* The annotations of a component's pods: {root, of}. A change of a setting replaces the pods. */}}
{{- define "meshmend.podAnnotations" -}}
checksum/config: {{ list .root.Values.config .root.Values.secret.values | toJson | sha256sum }}
{{- with .of.podAnnotations }}
{{ toYaml . }}
{{- end }}
{{- end -}}

{{/* A map of variables as a container's env. */}}
{{- define "meshmend.env" -}}
env:
  {{- range $name, $value := . }}
  - {name: {{ $name }}, value: {{ $value | quote }}}
  {{- end }}
{{- end -}}
