{{- define "hullcast.labels" -}}
app.kubernetes.io/name: hullcast
app.kubernetes.io/instance: {{ .Release.Name }}
{{- end }}

{{- define "hullcast.name" -}}
{{- if contains "hullcast" .Release.Name }}{{ .Release.Name | trunc 50 | trimSuffix "-" }}{{ else }}{{ printf "%s-hullcast" (.Release.Name | trunc 40 | trimSuffix "-") }}{{ end }}
{{- end }}

{{- /* The mebibytes of a quantity of memory, which the schema restricts to Mi, Gi and Ti. */ -}}
{{- define "hullcast.mebibytes" -}}
{{- $units := dict "Mi" 1 "Gi" 1024 "Ti" 1048576 -}}
{{- $unit := regexFind "[MGT]i$" . -}}
{{- mul (atoi (trimSuffix $unit .)) (get $units $unit) -}}
{{- end }}

{{- /* A value as in TOML. Helm reads every number as a float, which TOML tells from an integer. */ -}}
{{- define "hullcast.toml" -}}
{{- if and (kindIs "float64" .) (eq . (floor .)) }}{{ int64 . }}{{ else }}{{ toJson . }}{{ end }}
{{- end }}

{{- /* Refuses values that contradict each other, which a schema cannot express. */ -}}
{{- define "hullcast.check" -}}
{{- if and (not .Values.tls.secret) (not .Values.tls.allowPlaintext) }}
{{- fail "tls.secret is empty: give the name of a secret of the type kubernetes.io/tls, or set tls.allowPlaintext to true if only trusted machines can read the network" }}
{{- end }}
{{- if and .Values.tls.secret .Values.tls.allowPlaintext }}
{{- fail (printf "tls.secret is %q and tls.allowPlaintext is true: give only one of them" .Values.tls.secret) }}
{{- end }}
{{- if and .Values.tls.clientCertificates (not .Values.tls.secret) }}
{{- fail "tls.clientCertificates is true, and tls.secret is empty: clients cannot present certificates without TLS" }}
{{- end }}
{{- if and .Values.tokens.secret (not .Values.tokens.query) (not .Values.tokens.register) }}
{{- fail (printf "tokens.secret is %q, and tokens.query and tokens.register are empty: at least one key is needed" .Values.tokens.secret) }}
{{- end }}
{{- $memory := include "hullcast.mebibytes" .Values.resources.memory | int }}
{{- $rest := div (mul $memory (sub 100 (add (int .Values.budgets.memory) (int .Values.budgets.cache)))) 100 }}
{{- if lt (int $rest) 256 }}
{{- fail (printf "budgets.memory (%v %%) and budgets.cache (%v %%) leave %d MiB of resources.memory (%s): the process itself needs 256 MiB" .Values.budgets.memory .Values.budgets.cache (int $rest) .Values.resources.memory) }}
{{- end }}
{{- $budget := div (mul $memory (int .Values.budgets.memory)) 100 }}
{{- if and (lt (int $budget) 929) (not (or .Values.settings.max_message_bytes .Values.settings.max_points_per_hull)) }}
{{- fail (printf "budgets.memory (%v %%) is %d MiB of resources.memory (%s): with the default limits the server needs 929 MiB. Lower settings.max_message_bytes and settings.max_points_per_hull (docs/budget.md)" .Values.budgets.memory (int $budget) .Values.resources.memory) }}
{{- end }}
{{- if gt (int .Values.autoscaling.minReplicas) (int .Values.autoscaling.maxReplicas) }}
{{- fail (printf "autoscaling.minReplicas (%v) is more than autoscaling.maxReplicas (%v)" .Values.autoscaling.minReplicas .Values.autoscaling.maxReplicas) }}
{{- end }}
{{- if and (eq .Values.autoscaling.kind "keda") (not .Values.autoscaling.prometheus) }}
{{- fail "autoscaling.kind is keda, and autoscaling.prometheus is empty: give the URL of Prometheus" }}
{{- end }}
{{- if eq (int .Values.service.port) (int .Values.service.adminPort) }}
{{- fail (printf "service.port and service.adminPort are both %v: give them different ports" .Values.service.port) }}
{{- end }}
{{- end }}
