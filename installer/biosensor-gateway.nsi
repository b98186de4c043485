; The Windows installer, for all users of a PC. Built by installer/wine and by build.ps1:
;   makensis -DVERSION=0.1.0 -DPICTURES=folder -DBUNDLE=folder -DOUTPUT=setup.exe \
;     -DUNINSTALLER=uninstall.exe -DCOPY=cp biosensor-gateway.nsi
; BUNDLE holds bin (both programs and _internal), docs, licenses and sbom.cdx.json. Its
; bill of materials names the uninstaller, so a first run without -DBUNDLE makes that alone:
; UNINSTALLER gets it, by COPY ("copy /b" on Windows); it is the same in both.
;
; Silent:  setup.exe /S [/FIREWALL=0|1] [/AUTOSTART=0|1] [/FORCE=1] [/D=folder, last, without quotes]
;          uninstall.exe /S [/REMOVE_SETTINGS=1] [/FORCE=1] [_?=folder, last, without quotes]
; Exit codes: 0 done, 1 cancelled, 2 not done (Windows too old, the program cannot be
; closed, or a file cannot be written), 3 not done because it runs and /FORCE=1 was not given,
; 4 installed, but without the firewall rule, the start at logon or the command in PATH.
; Without _?= the uninstaller goes on as a copy of itself, and the code is 0 whatever comes of it.

; The 32-bit stub does nothing on a Wine that has no 32-bit part, and still says 0. NSIS for Windows
; has no other one: build.ps1 defines TARGET.
!ifndef TARGET
  !define TARGET amd64-unicode
!endif
Target ${TARGET}
ManifestSupportedOS Win10
RequestExecutionLevel admin
; Else a silent installation leaves out what it cannot write, and still says 0.
AllowSkipFiles off
SetCompressor /SOLID lzma
SetCompressorDictSize 32
; Else Windows enlarges it like a photograph on screens of a high resolution.
ManifestDPIAware true

!include MUI2.nsh
!include FileFunc.nsh
!include LogicLib.nsh
!include Sections.nsh
!include WinVer.nsh

!define NAME "Biosensor Gateway"
!define PROGRAM "biosensor-gateway"
!define EXE "${PROGRAM}.exe"
; Opens the page in a window of its own, without a console.
!define WINDOWED "${NAME}.exe"
; Nothing but the two is in the folder that PATH gets: an uninstall.exe there would be a command.
!define BIN "$INSTDIR\bin"
!define PUBLISHER "Biosensor Gateway contributors"
!define OWN_KEY "Software\${PROGRAM}"
!define UNINSTALL_KEY "Software\Microsoft\Windows\CurrentVersion\Uninstall\${PROGRAM}"
!define APP_PATH_KEY "Software\Microsoft\Windows\CurrentVersion\App Paths\${EXE}"

; Exit code of `installation holders` if something runs that it cannot close.
!define HELD 4
!define INCOMPLETE 4

; What "Check this PC" runs.
!define CHECK_COMMAND "doctor"

Name "${NAME}"
OutFile "${OUTPUT}"
; No whole path: it tells .onInit that there was no /D=, which NSIS reads itself. The folder
; dialog appends the name to what is chosen there.
!define NO_FOLDER "\${NAME}"
InstallDir "${NO_FOLDER}"
BrandingText "${NAME} ${VERSION}"
VIProductVersion "${VERSION}.0"
VIAddVersionKey ProductName "${NAME}"
VIAddVersionKey ProductVersion "${VERSION}"
VIAddVersionKey FileVersion "${VERSION}"
VIAddVersionKey FileDescription "${NAME} installer"
VIAddVersionKey CompanyName "${PUBLISHER}"
VIAddVersionKey LegalCopyright "Apache License 2.0"

!uninstfinalize '${COPY} "%1" "${UNINSTALLER}"'

!define MUI_ICON "${PICTURES}/icon.ico"
!define MUI_UNICON "${PICTURES}/icon.ico"
!define MUI_HEADERIMAGE
!define MUI_HEADERIMAGE_RIGHT
!define MUI_HEADERIMAGE_BITMAP "${PICTURES}/header.bmp"
!define MUI_HEADERIMAGE_BITMAP_STRETCH AspectFitHeight
!define MUI_HEADERIMAGE_UNBITMAP "${PICTURES}/header.bmp"
!define MUI_HEADERIMAGE_UNBITMAP_STRETCH AspectFitHeight
!define MUI_WELCOMEFINISHPAGE_BITMAP "${PICTURES}/welcome.bmp"
!define MUI_WELCOMEFINISHPAGE_BITMAP_STRETCH AspectFitHeight
; The list of choices gets the whole width, so that no label is cut off.
!define MUI_COMPONENTSPAGE_SMALLDESC
!define MUI_ABORTWARNING
!define MUI_WELCOMEPAGE_TEXT "${NAME} will be installed for all users of this PC. Nothing is started again, and no \
  other program needs to be closed.$\r$\n$\r$\nYour settings and recordings stay as they are.$\r$\n$\r$\n$_CLICK"
!define MUI_DIRECTORYPAGE_TEXT_TOP "Below Program Files only administrators can change it. Anywhere else others of this \
  PC may replace it, so there its command is not put into PATH.$\r$\n$\r$\n$_CLICK"
!define MUI_FINISHPAGE_NOAUTOCLOSE
!define MUI_FINISHPAGE_RUN
!define MUI_FINISHPAGE_RUN_TEXT "Open ${NAME}, to find your sensors"
!define MUI_FINISHPAGE_RUN_FUNCTION OpenPage
!insertmacro MUI_PAGE_WELCOME
!insertmacro MUI_PAGE_COMPONENTS
!insertmacro MUI_PAGE_DIRECTORY
!insertmacro MUI_PAGE_INSTFILES
!insertmacro MUI_PAGE_FINISH
!define MUI_PAGE_CUSTOMFUNCTION_SHOW un.HideSpace
!insertmacro MUI_UNPAGE_COMPONENTS
!insertmacro MUI_UNPAGE_INSTFILES
!insertmacro MUI_LANGUAGE English

; ---- Closing a running program -----------------------------------------------------------

; A program that runs cannot be opened for writing.
!macro IsRunning result
  StrCpy ${result} 0
  !insertmacro _IsRunning "${EXE}" ${result}
  !insertmacro _IsRunning "${WINDOWED}" ${result}
!macroend

!macro _IsRunning program result
  ${If} ${FileExists} "$R8\bin\${program}"
    ClearErrors
    FileOpen $R9 "$R8\bin\${program}" a
    ${If} ${Errors}
      StrCpy ${result} 1
    ${Else}
      FileClose $R9
    ${EndIf}
  ${EndIf}
!macroend

; Folder of the program that may be run as administrator.
Var Tools

; Of the folder in $R8, by what is in $Tools.
!macro CloseProgram un
Function ${un}CloseProgram
  !insertmacro IsRunning $R0
  ${If} $R0 == 0
    Return
  ${EndIf}
  ${If} ${Silent}
    ; Nobody can be asked, and a recording may be going on.
    ${GetParameters} $R0
    ClearErrors
    ${GetOptions} $R0 "/FORCE=" $R1
    ${If} ${Errors}
    ${OrIf} $R1 != 1
      SetErrorLevel 3
      Quit
    ${EndIf}
  ${Else}
    MessageBox MB_OKCANCEL|MB_ICONEXCLAMATION \
      "${NAME} is running. Press OK to close it: a recording is ended, its devices are disconnected \
      and its streams end." \
      IDOK close
    SetErrorLevel 1
    Quit
  ${EndIf}
close:
  ; Nothing is closed unless all can be: what a version says that knows the question.
  StrCpy $R3 ""
  nsExec::ExecToStack '"$Tools\${EXE}" installation holders'
  Pop $R1
  ${If} $R1 == ${HELD}
    Pop $R3
    Goto held
  ${EndIf}
  Pop $R1
  ; First, so that its file is closed while its streams are there.
  nsExec::Exec '"$Tools\${EXE}" record stop'
  Pop $R1
  nsExec::Exec '"$Tools\${EXE}" page --end'
  Pop $R1
  nsExec::Exec '"$Tools\${EXE}" stop --while-recording'
  Pop $R1
  ; Its window, or a command in another one, may need a moment more.
  StrCpy $R2 0
wait:
  !insertmacro IsRunning $R0
  ${If} $R0 == 0
    Return
  ${EndIf}
  ${If} $R2 < 20
    IntOp $R2 $R2 + 1
    Sleep 500
    Goto wait
  ${EndIf}
held:
  ${If} $R3 == ""
    StrCpy $R3 "It did not end within 10 seconds."
  ${EndIf}
  MessageBox MB_OK|MB_ICONSTOP \
    "${NAME} cannot be closed from here; nothing was changed. What runs:$\r$\n$\r$\n$R3$\r$\n$\r$\nEnd it where it \
    was started, then try again." /SD IDOK
  SetErrorLevel 2
  Quit
FunctionEnd
!macroend
!insertmacro CloseProgram ""
!insertmacro CloseProgram "un."

Var EarlierAutostart

; ---- Installation ------------------------------------------------------------------------

Function OpenPage
  ; As the user who began, not as the administrator that the installer became.
  Exec '"$WINDIR\explorer.exe" "$SMPROGRAMS\${NAME}\${NAME}.lnk"'
FunctionEnd

; Sets $R8 to where the program is now, or will be.
!macro FindEarlierVersion
  ReadRegStr $R8 HKLM "${UNINSTALL_KEY}" "InstallLocation"
  ${If} $R8 == ""
    StrCpy $R8 $INSTDIR
  ${EndIf}
!macroend

; Sets $R0 to 1 if only administrators can change what is in the folder in $R1: whoever can write
; into a folder of the system's PATH can have others run what they like.
Function IsProtected
  StrCpy $R0 0
  GetFullPathName $R1 $R1
  StrLen $R2 "$PROGRAMFILES64\"
  StrCpy $R3 $R1 $R2
  ${If} $R3 == "$PROGRAMFILES64\"
    StrCpy $R0 1
  ${EndIf}
FunctionEnd

; Sets $Tools for the folder in $R1. Where others can change what is there, this administrator would
; run what they like: then it is a copy of what this installer brings, where they cannot.
Function FindTools
  StrCpy $Tools "$R1\bin"
  Call IsProtected
  ${If} $R0 == 1
    Return
  ${EndIf}
  InitPluginsDir
  StrCpy $Tools "$PLUGINSDIR\bin"
  ${If} ${FileExists} "$Tools\${EXE}"
    Return
  ${EndIf}
  DetailPrint "Unpacking what is run as administrator ..."
  SetOutPath "$PLUGINSDIR"
!ifdef BUNDLE
  File /r "${BUNDLE}\bin"
!endif
  ; Else it could not be removed at the end.
  SetOutPath "$TEMP"
FunctionEnd

; Files are replaced as a whole, so that none of an earlier version stays.
Function RemoveEarlierVersion
  ReadRegStr $R0 HKLM "${UNINSTALL_KEY}" "InstallLocation"
  ${If} $R0 == ""
  ${OrIfNot} ${FileExists} "$R0\uninstall.exe"
    Return
  ${EndIf}
  StrCpy $R2 "$R0\uninstall.exe"
  ${If} $Tools != "$R0\bin"
    StrCpy $R2 "$PLUGINSDIR\uninstall.exe"
    WriteUninstaller "$PLUGINSDIR\uninstall.exe"
  ${EndIf}
  ; With _?= it works where it lies and can be waited for, but cannot remove itself.
  ; Who starts it at logon stays as it is.
  ExecWait '"$R2" /S /UPGRADE=1 /TOOLS="$Tools" _?=$R0' $R1
  ${If} $R1 != 0
    MessageBox MB_OK|MB_ICONSTOP \
      "The earlier version in $R0 could not be removed. Close ${NAME}, then try again." /SD IDOK
    SetErrorLevel 2
    Quit
  ${EndIf}
  Delete "$R0\uninstall.exe"
  RMDir "$R0"
FunctionEnd

Section "${NAME}" SectionProgram
  SectionIn RO
  !insertmacro FindEarlierVersion
  ${If} ${FileExists} "$R8\*.*"
    StrCpy $R1 $R8
    Call FindTools
  ${EndIf}
  Call CloseProgram
  Call RemoveEarlierVersion
  SetOutPath "$INSTDIR"
!ifdef BUNDLE
  File /r "${BUNDLE}\*.*"
!endif
  WriteUninstaller "$INSTDIR\uninstall.exe"

  CreateDirectory "$SMPROGRAMS\${NAME}"
  ; A console window that closes takes its last sentence along: these stay open.
  ; They start in the folder of whoever opens them, so the name is left to be expanded then.
  StrCpy $OUTDIR "%USERPROFILE%"
  CreateShortcut "$SMPROGRAMS\${NAME}\${NAME}.lnk" "${BIN}\${WINDOWED}" "" \
    "${BIN}\${WINDOWED}" 0 SW_SHOWNORMAL "" "Find sensors, see and record them"
  CreateShortcut "$SMPROGRAMS\${NAME}\Run in a console.lnk" "$SYSDIR\cmd.exe" \
    '/k ""${BIN}\${EXE}" run"' "${BIN}\${EXE}" 0
  CreateShortcut "$SMPROGRAMS\${NAME}\Check this PC.lnk" "$SYSDIR\cmd.exe" \
    '/k ""${BIN}\${EXE}" ${CHECK_COMMAND}"' "${BIN}\${EXE}" 0
  CreateShortcut "$SMPROGRAMS\${NAME}\Settings.lnk" "$SYSDIR\cmd.exe" \
    '/c ""${BIN}\${EXE}" config edit || pause"' "${BIN}\${EXE}" 0
  CreateShortcut "$SMPROGRAMS\${NAME}\Documentation.lnk" "$INSTDIR\docs\index.html"
  CreateShortcut "$SMPROGRAMS\${NAME}\Uninstall.lnk" "$INSTDIR\uninstall.exe"
  SetOutPath "$INSTDIR"

  WriteRegStr HKLM "${APP_PATH_KEY}" "" "${BIN}\${EXE}"
  WriteRegStr HKLM "${APP_PATH_KEY}" "Path" "${BIN}"
  ; App Paths serves the Run dialog and `start`; a terminal looks into PATH alone.
  StrCpy $R1 $INSTDIR
  Call IsProtected
  ${If} $R0 == 1
    nsExec::ExecToLog '"${BIN}\${EXE}" installation add-to-path "${BIN}"'
    Pop $R0
    ${If} $R0 != 0
      SetErrorLevel ${INCOMPLETE}
    ${EndIf}
  ${Else}
    DetailPrint "Not below $PROGRAMFILES64, where only administrators can write."
    StrCpy $R0 1
  ${EndIf}
  ${If} $R0 != 0
    DetailPrint "PATH was not changed: terminals need the whole path of ${EXE}."
  ${EndIf}

  WriteRegStr HKLM "${UNINSTALL_KEY}" "DisplayName" "${NAME}"
  WriteRegStr HKLM "${UNINSTALL_KEY}" "DisplayVersion" "${VERSION}"
  WriteRegStr HKLM "${UNINSTALL_KEY}" "DisplayIcon" "${BIN}\${EXE}"
  WriteRegStr HKLM "${UNINSTALL_KEY}" "Publisher" "${PUBLISHER}"
  WriteRegStr HKLM "${UNINSTALL_KEY}" "InstallLocation" "$INSTDIR"
  WriteRegStr HKLM "${UNINSTALL_KEY}" "UninstallString" '"$INSTDIR\uninstall.exe"'
  ; Where it lies, for only then winget and scripts learn what came of it.
  WriteRegStr HKLM "${UNINSTALL_KEY}" "QuietUninstallString" '"$INSTDIR\uninstall.exe" /S _?=$INSTDIR'
  WriteRegDWORD HKLM "${UNINSTALL_KEY}" "NoModify" 1
  WriteRegDWORD HKLM "${UNINSTALL_KEY}" "NoRepair" 1
  ${GetSize} "$INSTDIR" "/S=0K" $R0 $R1 $R2
  WriteRegDWORD HKLM "${UNINSTALL_KEY}" "EstimatedSize" $R0
SectionEnd

Section /o "Firewall rule" SectionFirewall
  nsExec::ExecToLog '"$SYSDIR\netsh.exe" advfirewall firewall add rule name="${NAME}" \
    dir=in action=allow program="${BIN}\${EXE}" \
    remoteip=LocalSubnet profile=private,domain enable=yes'
  Pop $R0
  ${If} $R0 == 0
    WriteRegDWORD HKLM "${OWN_KEY}" "Firewall" 1
  ${Else}
    SetErrorLevel ${INCOMPLETE}
    DetailPrint "The firewall rule could not be added (netsh: $R0)."
    MessageBox MB_OK|MB_ICONEXCLAMATION \
      "The firewall rule could not be added. Allow ${EXE} by hand in the firewall's settings." \
      /SD IDOK
  ${EndIf}
SectionEnd

; Asks the program, which finds the user of this session: the installer's own one is the
; administrator who allowed it.
; At logon nobody is there to start it again, so it does that itself.
!macro Autostart choice
  StrCpy $R1 $INSTDIR
  Call FindTools
  nsExec::ExecToLog '"$Tools\${EXE}" installation autostart ${choice} \
    "\"$SYSDIR\cmd.exe\" /c start \"${NAME}\" /min \"${BIN}\${EXE}\" run --no-ask --keep-alive"'
  Pop $R0
!macroend

Section /o "Start at logon" SectionAutostart
  !insertmacro Autostart "--on"
  ${If} $R0 != 0
    SetErrorLevel ${INCOMPLETE}
    DetailPrint "It will not start at logon: no user is logged on in this session."
    MessageBox MB_OK|MB_ICONEXCLAMATION \
      "It could not be set to start when you log on: Windows did not tell who you are." /SD IDOK
  ${EndIf}
SectionEnd

Section "-"
  ${IfNot} ${SectionIsSelected} ${SectionAutostart}
  ${AndIf} $EarlierAutostart == 1
    !insertmacro Autostart "--off"
  ${EndIf}
SectionEnd

LangString ABOUT_PROGRAM ${LANG_ENGLISH} "The capture agent, its documentation, its \
  Start-menu entries and its command."
LangString ABOUT_FIREWALL ${LANG_ENGLISH} "Lets computers of the same subnet receive the streams, in \
  networks that are private or domain."
LangString ABOUT_AUTOSTART ${LANG_ENGLISH} "Runs in a minimised window when you log on to Windows; for your \
  own user account only."
!insertmacro MUI_FUNCTION_DESCRIPTION_BEGIN
  !insertmacro MUI_DESCRIPTION_TEXT ${SectionProgram} $(ABOUT_PROGRAM)
  !insertmacro MUI_DESCRIPTION_TEXT ${SectionFirewall} $(ABOUT_FIREWALL)
  !insertmacro MUI_DESCRIPTION_TEXT ${SectionAutostart} $(ABOUT_AUTOSTART)
!insertmacro MUI_FUNCTION_DESCRIPTION_END

; What was chosen before is chosen again, unless the command line says otherwise.
!macro Choose section option earlier
  ${GetOptions} $R0 "/${option}=" $R1
  ${If} ${Errors}
    StrCpy $R1 ${earlier}
  ${EndIf}
  ${If} $R1 == 1
    !insertmacro SelectSection ${section}
  ${EndIf}
!macroend

Function .onInit
  ${IfNot} ${AtLeastWin10}
    MessageBox MB_OK|MB_ICONSTOP "${NAME} needs Windows 10 or 11, 64 bit." /SD IDOK
    SetErrorLevel 2
    Quit
  ${EndIf}
  SetRegView 64
  SetShellVarContext all
  ${If} $INSTDIR == "${NO_FOLDER}"
    ; An upgrade goes where the program is.
    ReadRegStr $INSTDIR HKLM "${UNINSTALL_KEY}" "InstallLocation"
    ${If} $INSTDIR == ""
      StrCpy $INSTDIR "$PROGRAMFILES64\${NAME}"
    ${EndIf}
  ${EndIf}
  ${GetParameters} $R0
  ReadRegDWORD $R2 HKLM "${OWN_KEY}" "Firewall"
  ClearErrors
  !insertmacro Choose ${SectionFirewall} "FIREWALL" $R2
  StrCpy $EarlierAutostart 0
  !insertmacro FindEarlierVersion
  ${If} ${FileExists} "$R8\bin\${EXE}"
    StrCpy $R1 $R8
    Call FindTools
    nsExec::Exec '"$Tools\${EXE}" installation autostart-state'
    Pop $R3
    ${If} $R3 == 0
      StrCpy $EarlierAutostart 1
    ${EndIf}
  ${EndIf}
  ${GetParameters} $R0
  ClearErrors
  !insertmacro Choose ${SectionAutostart} "AUTOSTART" $EarlierAutostart
  ClearErrors
FunctionEnd

; A removal needs no space.
Function un.HideSpace
  FindWindow $R0 "#32770" "" $HWNDPARENT
  GetDlgItem $R1 $R0 1023
  ShowWindow $R1 ${SW_HIDE}
FunctionEnd

; NSIS keeps its own file open, so where it works in place it cannot be deleted before it has ended.
Function un.RemoveItself
  SetOutPath "$TEMP"
  Delete "$INSTDIR\uninstall.exe"
  ${IfNot} ${FileExists} "$INSTDIR\uninstall.exe"
    Return
  ${EndIf}
  ${GetParameters} $R0
  ClearErrors
  ${GetOptions} $R0 "/UPGRADE=" $R1
  ${IfNot} ${Errors}
    ; The installer that waits deletes it.
    Return
  ${EndIf}
  ; `ping` waits a second; `rmdir` takes an empty folder only.
  ExecShell "open" "$SYSDIR\cmd.exe" '/d /c for /l %i in (1,1,60) do (\
    ping -n 2 127.0.0.1 >nul & del /q "$INSTDIR\uninstall.exe" 2>nul & \
    if not exist "$INSTDIR\uninstall.exe" (rmdir "$INSTDIR" 2>nul & exit))' SW_HIDE
FunctionEnd

; ---- Removal -----------------------------------------------------------------------------

; First, because the program itself takes its secrets out of the system's keyring.
Section /o "un.Your settings, logs and secrets" SectionSettings
  StrCpy $R8 $INSTDIR
  Call un.CloseProgram
  nsExec::Exec '"$Tools\${EXE}" secrets forget --all'
  Pop $R0
  SetShellVarContext current
  RMDir /r "$LOCALAPPDATA\${PROGRAM}"
  SetShellVarContext all
SectionEnd

Section "un.${NAME}" SectionRemoval
  SectionIn RO
  StrCpy $R8 $INSTDIR
  Call un.CloseProgram
  nsExec::ExecToLog '"$Tools\${EXE}" installation remove-from-path "${BIN}"'
  Pop $R0
  ${GetParameters} $R0
  ClearErrors
  ${GetOptions} $R0 "/UPGRADE=" $R1
  ${If} ${Errors}
    nsExec::ExecToLog '"$Tools\${EXE}" installation remove-autostart'
    Pop $R0
  ${EndIf}
  ReadRegDWORD $R0 HKLM "${OWN_KEY}" "Firewall"
  ${If} $R0 == 1
    nsExec::ExecToLog '"$SYSDIR\netsh.exe" advfirewall firewall delete rule name="${NAME}"'
    Pop $R0
  ${EndIf}
  DeleteRegKey HKLM "${OWN_KEY}"
  DeleteRegKey HKLM "${APP_PATH_KEY}"
  DeleteRegKey HKLM "${UNINSTALL_KEY}"

  Delete "$SMPROGRAMS\${NAME}\${NAME}.lnk"
  Delete "$SMPROGRAMS\${NAME}\Run in a console.lnk"
  Delete "$SMPROGRAMS\${NAME}\Check this PC.lnk"
  Delete "$SMPROGRAMS\${NAME}\Settings.lnk"
  Delete "$SMPROGRAMS\${NAME}\Documentation.lnk"
  Delete "$SMPROGRAMS\${NAME}\Uninstall.lnk"
  RMDir "$SMPROGRAMS\${NAME}"

  ; Only what is ours: the folder itself goes if nothing else is in it.
  RMDir /r "${BIN}\_internal"
  Delete "${BIN}\${EXE}"
  Delete "${BIN}\${WINDOWED}"
  RMDir "${BIN}"
  RMDir /r "$INSTDIR\docs"
  RMDir /r "$INSTDIR\licenses"
  Delete "$INSTDIR\sbom.cdx.json"
  Call un.RemoveItself
  RMDir "$INSTDIR"
SectionEnd

LangString ABOUT_REMOVAL ${LANG_ENGLISH} "The program and all else that was installed. Recordings are never \
  touched."
LangString ABOUT_SETTINGS ${LANG_ENGLISH} "Your settings, logs and secrets for vendors' services, for good. \
  Those of other users stay."
!insertmacro MUI_UNFUNCTION_DESCRIPTION_BEGIN
  !insertmacro MUI_DESCRIPTION_TEXT ${SectionRemoval} $(ABOUT_REMOVAL)
  !insertmacro MUI_DESCRIPTION_TEXT ${SectionSettings} $(ABOUT_SETTINGS)
!insertmacro MUI_UNFUNCTION_DESCRIPTION_END

Function un.onInit
  SetRegView 64
  SetShellVarContext all
  ${GetParameters} $R0
  ClearErrors
  ; Of an installer, where others can change what is here.
  ${GetOptions} $R0 "/TOOLS=" $Tools
  ${If} ${Errors}
    StrCpy $Tools "${BIN}"
  ${EndIf}
  ClearErrors
  ${GetOptions} $R0 "/REMOVE_SETTINGS=" $R1
  ${IfNot} ${Errors}
  ${AndIf} $R1 == 1
    !insertmacro SelectSection ${SectionSettings}
  ${EndIf}
  ClearErrors
FunctionEnd
