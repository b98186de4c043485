; A program in the place of the installed one, for tests of the installer alone. It notes its
; command line in C:\calls.txt, and in C:\places.txt where it lies, runs until there is C:\end, which `stop` makes, and answers
; `installation ...` with what is in the file of that command's name, or 0.
Target amd64-unicode
Name stub
OutFile "${OUTPUT}"
SilentInstall silent
RequestExecutionLevel user
!include FileFunc.nsh
!include LogicLib.nsh
!include WordFunc.nsh

Section
  ${GetParameters} $R0
  FileOpen $R1 "C:\calls.txt" a
  FileSeek $R1 0 END
  FileWrite $R1 "$R0$\r$\n"
  FileClose $R1
  FileOpen $R1 "C:\places.txt" a
  FileSeek $R1 0 END
  FileWrite $R1 "$EXEPATH$\r$\n"
  FileClose $R1
  ${WordFind} $R0 " " "+1" $R2
  ${If} $R2 == "run"
    ${DoUntil} ${FileExists} "C:\end"
      Sleep 100
    ${Loop}
  ${ElseIf} $R2 == "stop"
    FileOpen $R1 "C:\end" w
    FileClose $R1
  ${ElseIf} $R2 == "installation"
    ${WordFind} $R0 " " "+2" $R2
    ${If} ${FileExists} "C:\$R2.txt"
      FileOpen $R1 "C:\$R2.txt" r
      FileRead $R1 $R3
      FileClose $R1
      SetErrorLevel $R3
    ${EndIf}
  ${EndIf}
SectionEnd
