#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# What a program says about itself: every option of every --help stands in the manual page and in each completion script;
# the page has no error of roff; the bash script completes; zsh and fish take theirs, where they are installed.
# Usage: documents.sh PATH/eigencast-sender|eigencast-broker|eigencast-client|eigencast-latency
set -euo pipefail
program=$1
name=$(basename "$program")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
fail() { echo "FAILED: $*"; exit 1; }

"$program" man > "$folder/man"
for shell in bash zsh fish; do "$program" completion $shell > "$folder/$shell"; done

case $name in
  eigencast-sender) most=60
    commands=("" bake play pipe deform export evaluate replay compare context "context add" "context list" "context use" "context remove" completion) ;;
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
    grep -qF -- "${option//-/\\-}" "$folder/man" || fail "$command $option is not in the manual page"
    grep -qF -- "$option" "$folder/bash" || fail "$command $option is not in the completion for bash"
    grep -qF -- "$option" "$folder/zsh" || fail "$command $option is not in the completion for zsh"
    grep -qF -- "-l ${option#--}" "$folder/fish" || fail "$command $option is not in the completion for fish"
  done
done
[ $options -gt $most ] || fail "only $options options found in the help texts"

if [ "$name" = eigencast-sender ]; then
  said=$("$program" nonsense 2>&1) && fail "a command that is not there is taken"
  [[ $said == *'no command "nonsense"'*evaluate* ]] || fail "of a command that is not there is said: $said"
fi

if command -v groff > /dev/null; then
  warnings=$(groff -man -ww -Tutf8 -z "$folder/man" 2>&1)
  [ -z "$warnings" ] || fail "$warnings"
fi
grep -q "$HOME" "$folder/man" && fail "the manual page holds a path of this machine"

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
  completes "eigencast-broker completion " bash zsh fish
elif [ "$name" = eigencast-latency ]; then
  completes "eigencast-latency p" pair passive probe
  completes "eigencast-latency completion " bash zsh fish
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
  completes "eigencast-sender completion " bash zsh fish
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
if command -v fish > /dev/null; then
  fish --no-execute "$folder/fish" || fail "fish refuses its script"
  fish_completes() {  # as completes
    local found
    found=$(HOME=$folder fish --no-config -c 'source $argv[1]; complete -C $argv[2]' "$folder/fish" "$1" | cut -f1 | tr '\n' ' ')
    for word in "${@:2}"; do [[ " $found" == *" $word "* ]] || fail "'$1' completes to '$found' in fish, without $word"; done
  }
  if [ "$name" = eigencast-client ]; then
    fish_completes "$name --colour-map " viridis cividis coolwarm
  else
    fish_completes "$name completion " bash zsh fish
  fi
  if [ "$name" = eigencast-sender ]; then
    fish_completes "$name p" play pipe
    fish_completes "$name play --basis " augmented rig pca
    fish_completes "$name context " add list use remove
  fi
else
  skipped=1
  echo "SKIPPED: no fish"
fi
echo "$options options, ${#commands[@]} help texts: all the same"
[ $skipped = 0 ] || exit 77
