#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Every option of every --help is in --help-all, which manual pages are made from, and in each completion script; bash completes by its
# script, and zsh loads its own, where it is installed.
# Usage: documents.sh PATH/eigencast-sender|eigencast-broker|eigencast-client|eigencast-latency
set -euo pipefail
program=$1
name=$(basename "$program")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
skipped=0
fail() { echo "FAILED: $*"; exit 1; }

"$program" --help-all > "$folder/help"
for shell in bash zsh; do "$program" completion $shell > "$folder/$shell"; done

case $name in
  eigencast-sender) most=60
    commands=("" bake play pipe deform export evaluate replay context "context add" "context list" "context use" "context remove" completion) ;;
  eigencast-broker) most=20
    commands=("" token "token create" "token inspect" completion) ;;
  eigencast-client) most=40 commands=("") ;;
  eigencast-latency) most=30 commands=("" loop pair passive probe sweep compare completion) ;;
  *) fail "what $name can be asked is not known here" ;;
esac
options=0
for command in "${commands[@]}"; do
  # shellcheck disable=SC2086
  for option in $("$program" $command --help | grep -oE '^ +(-[a-z],)?--[a-z-]+' | grep -oE '\-\-[a-z-]+'); do
    options=$((options + 1))
    grep -qF -- "$option" "$folder/help" || fail "$command $option is not in --help-all"
    grep -qF -- "$option" "$folder/bash" || fail "$command $option is not in the completion for bash"
    grep -qF -- "$option" "$folder/zsh" || fail "$command $option is not in the completion for zsh"
  done
done
[ $options -gt $most ] || fail "only $options options found in the help texts"

if [ "$name" = eigencast-sender ]; then
  status=0
  "$program" nonsense > /dev/null 2>&1 || status=$?
  [ $status = 2 ] || fail "an unknown command ends with $status"
fi

grep -q "$HOME" "$folder/help" && fail "--help-all holds a path of this machine"

# shellcheck disable=SC1091
source "$folder/bash"
completes() {  # completes "words typed" expected...; as bash does, = is a word
  read -ra COMP_WORDS <<< "${1//=/ = }"
  [[ $1 == *' ' ]] && COMP_WORDS+=("")
  COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
  COMPREPLY=()
  "_${name//-/_}"
  for word in "${@:2}"; do
    [[ " ${COMPREPLY[*]} " == *" $word "* ]] || fail "'$1' completes to '${COMPREPLY[*]}', without $word"
  done
}
if [ "$name" = eigencast-broker ]; then
  completes "eigencast-broker token " create inspect
  completes "eigencast-broker token create --s" --subscribe --subject --static
  completes "eigencast-broker --check" --check-config
  completes "eigencast-broker completion " bash zsh
elif [ "$name" = eigencast-latency ]; then
  completes "eigencast-latency p" pair passive probe
  completes "eigencast-latency completion " bash zsh
elif [ "$name" = eigencast-client ]; then
  completes "eigencast-client --colour-m" --colour-map
  completes "eigencast-client --colour-map " viridis cividis coolwarm
else
  completes "eigencast-sender p" play pipe
  completes "eigencast-sender play --ra" --rate --rank
  completes "eigencast-sender play --basis " augmented harmonic rig cage pca
  completes "eigencast-sender play --basis=" augmented pca
  completes "eigencast-sender play --basis=r" rig
  completes "eigencast-sender -v context " add list use remove
  touch "$folder/my mesh.obj"
  completes "eigencast-sender play $folder/my" "$folder/my mesh.obj"
  completes "eigencast-sender completion " bash zsh
fi

if command -v zsh > /dev/null; then
  zsh -n "$folder/zsh" || fail "zsh refuses its script"
  mkdir "$folder/functions"
  cp "$folder/zsh" "$folder/functions/_$name"
  # shellcheck disable=SC2016
  found=$(zsh -f -c 'fpath=($1 $fpath); autoload -U compinit; compinit -D -u; autoload +X _$2 && print $_comps[$2]' zsh "$folder/functions" "$name")
  [ "$found" = "_$name" ] || fail "zsh completes $name with '$found'"
else
  skipped=1
  echo "SKIPPED: no zsh"
fi
echo "$options options, ${#commands[@]} help texts: all the same"
[ $skipped = 0 ] || exit 77
