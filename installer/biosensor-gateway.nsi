; The Windows installer, for all users of a PC. Built by installer/wine and by build.ps1:
;   makensis -DVERSION=0.1.0 -DBUNDLE=folder -DOUTPUT=setup.exe biosensor-gateway.nsi
; BUNDLE holds biosensor-gateway.exe, _internal, licenses and sbom.cdx.json.
;
; Silent:  setup.exe /S [/FIREWALL=0|1] [/AUTOSTART=0|1] [/D=folder, last, without quotes]
;          uninstall.exe /S [/REMOVE_SETTINGS=1]
; Exit codes: 0 done, 1 cancelled, 2 not done (Windows too old, the program cannot be
; closed, or a file cannot be written).

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

!include MUI2.nsh
!include FileFunc.nsh
!include LogicLib.nsh
!include Sections.nsh
!include WinVer.nsh

!define NAME "Biosensor Gateway"
!define PROGRAM "biosensor-gateway"
!define EXE "${PROGRAM}.exe"
!define PUBLISHER "Biosensor Gateway contributors"
!define OWN_KEY "Software\${PROGRAM}"
!define UNINSTALL_KEY "Software\Microsoft\Windows\CurrentVersion\Uninstall\${PROGRAM}"
!define APP_PATH_KEY "Software\Microsoft\Windows\CurrentVersion\App Paths\${EXE}"
!define RUN_KEY "Software\Microsoft\Windows\CurrentVersion\Run"

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

!define MUI_ABORTWARNING
!define MUI_FINISHPAGE_NOAUTOCLOSE
!define MUI_FINISHPAGE_RUN
!define MUI_FINISHPAGE_RUN_TEXT "Open the settings, to describe your sensors"
!define MUI_FINISHPAGE_RUN_FUNCTION OpenSettings
!insertmacro MUI_PAGE_WELCOME
!insertmacro MUI_PAGE_COMPONENTS
!insertmacro MUI_PAGE_DIRECTORY
!insertmacro MUI_PAGE_INSTFILES
!insertmacro MUI_PAGE_FINISH
!insertmacro MUI_UNPAGE_COMPONENTS
!insertmacro MUI_UNPAGE_INSTFILES
!insertmacro MUI_LANGUAGE English

; ---- Closing a running program -----------------------------------------------------------

; A program that runs cannot be opened for writing.
!macro IsRunning result
  StrCpy ${result} 0
  ${If} ${FileExists} "$INSTDIR\${EXE}"
    ClearErrors
    FileOpen $R9 "$INSTDIR\${EXE}" a
    ${If} ${Errors}
      StrCpy ${result} 1
    ${Else}
      FileClose $R9
    ${EndIf}
  ${EndIf}
!macroend

!macro CloseProgram un
Function ${un}CloseProgram
  !insertmacro IsRunning $R0
  ${If} $R0 == 0
    Return
  ${EndIf}
  MessageBox MB_OKCANCEL|MB_ICONEXCLAMATION \
    "${NAME} is running. Press OK to close it: its devices are disconnected and its streams end." \
    /SD IDOK IDOK close
  SetErrorLevel 1
  Quit
close:
  nsExec::Exec '"$INSTDIR\${EXE}" stop'
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
  MessageBox MB_OK|MB_ICONSTOP \
    "${NAME} is still running, perhaps for another user. End it there, then try again." /SD IDOK
  SetErrorLevel 2
  Quit
FunctionEnd
!macroend
!insertmacro CloseProgram ""
!insertmacro CloseProgram "un."

; ---- Installation ------------------------------------------------------------------------

Function OpenSettings
  ; As the user who began, not as the administrator that the installer became.
  Exec '"$WINDIR\explorer.exe" "$SMPROGRAMS\${NAME}\Settings.lnk"'
FunctionEnd

; Files are replaced as a whole, so that none of an earlier version stays.
Function RemoveEarlierVersion
  ReadRegStr $R0 HKLM "${UNINSTALL_KEY}" "InstallLocation"
  ${If} $R0 == ""
  ${OrIfNot} ${FileExists} "$R0\uninstall.exe"
    Return
  ${EndIf}
  ; With _?= it works where it lies and can be waited for, but cannot remove itself.
  ExecWait '"$R0\uninstall.exe" /S _?=$R0' $R1
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
  Call CloseProgram
  Call RemoveEarlierVersion
  SetOutPath "$INSTDIR"
  File /r "${BUNDLE}\*.*"
  WriteUninstaller "$INSTDIR\uninstall.exe"

  CreateDirectory "$SMPROGRAMS\${NAME}"
  ; A console window that closes takes its last sentence along: these stay open.
  ; They start in the folder of whoever opens them, so the name is left to be expanded then.
  StrCpy $OUTDIR "%USERPROFILE%"
  CreateShortcut "$SMPROGRAMS\${NAME}\${NAME}.lnk" "$SYSDIR\cmd.exe" \
    '/k ""$INSTDIR\${EXE}" run"' "$INSTDIR\${EXE}" 0
  CreateShortcut "$SMPROGRAMS\${NAME}\Check this PC.lnk" "$SYSDIR\cmd.exe" \
    '/k ""$INSTDIR\${EXE}" ${CHECK_COMMAND}"' "$INSTDIR\${EXE}" 0
  CreateShortcut "$SMPROGRAMS\${NAME}\Settings.lnk" "$SYSDIR\cmd.exe" \
    '/c ""$INSTDIR\${EXE}" config edit || pause"' "$INSTDIR\${EXE}" 0
  CreateShortcut "$SMPROGRAMS\${NAME}\Uninstall.lnk" "$INSTDIR\uninstall.exe"
  SetOutPath "$INSTDIR"

  WriteRegStr HKLM "${APP_PATH_KEY}" "" "$INSTDIR\${EXE}"
  WriteRegStr HKLM "${APP_PATH_KEY}" "Path" "$INSTDIR"
  ; App Paths serves the Run dialog and `start`; a terminal looks into PATH alone.
  nsExec::ExecToLog '"$INSTDIR\${EXE}" installation add-to-path "$INSTDIR"'
  Pop $R0
  ${If} $R0 != 0
    DetailPrint "PATH was not changed: terminals need the whole path of ${EXE}."
  ${EndIf}

  WriteRegStr HKLM "${UNINSTALL_KEY}" "DisplayName" "${NAME}"
  WriteRegStr HKLM "${UNINSTALL_KEY}" "DisplayVersion" "${VERSION}"
  WriteRegStr HKLM "${UNINSTALL_KEY}" "DisplayIcon" "$INSTDIR\${EXE}"
  WriteRegStr HKLM "${UNINSTALL_KEY}" "Publisher" "${PUBLISHER}"
  WriteRegStr HKLM "${UNINSTALL_KEY}" "InstallLocation" "$INSTDIR"
  WriteRegStr HKLM "${UNINSTALL_KEY}" "UninstallString" '"$INSTDIR\uninstall.exe"'
  WriteRegStr HKLM "${UNINSTALL_KEY}" "QuietUninstallString" '"$INSTDIR\uninstall.exe" /S'
  WriteRegDWORD HKLM "${UNINSTALL_KEY}" "NoModify" 1
  WriteRegDWORD HKLM "${UNINSTALL_KEY}" "NoRepair" 1
  ${GetSize} "$INSTDIR" "/S=0K" $R0 $R1 $R2
  WriteRegDWORD HKLM "${UNINSTALL_KEY}" "EstimatedSize" $R0
SectionEnd

Section /o "Allow it through the firewall, for the local subnet" SectionFirewall
  nsExec::ExecToLog '"$SYSDIR\netsh.exe" advfirewall firewall add rule name="${NAME}" \
    dir=in action=allow program="$INSTDIR\${EXE}" \
    remoteip=LocalSubnet profile=private,domain enable=yes'
  Pop $R0
  ${If} $R0 == 0
    WriteRegDWORD HKLM "${OWN_KEY}" "Firewall" 1
  ${Else}
    DetailPrint "The firewall rule could not be added (netsh: $R0)."
    MessageBox MB_OK|MB_ICONEXCLAMATION \
      "The firewall rule could not be added. Allow ${EXE} by hand in the firewall's settings." \
      /SD IDOK
  ${EndIf}
SectionEnd

Section /o "Start it when you log on" SectionAutostart
  WriteRegStr HKCU "${RUN_KEY}" "${NAME}" \
    '"$SYSDIR\cmd.exe" /c start "${NAME}" /min "$INSTDIR\${EXE}" run'
SectionEnd

LangString ABOUT_PROGRAM ${LANG_ENGLISH} "The capture agent, its Start-menu entries and its command."
LangString ABOUT_FIREWALL ${LANG_ENGLISH} "Other computers of the same subnet may receive the \
  streams, in networks that Windows calls private or domain."
LangString ABOUT_AUTOSTART ${LANG_ENGLISH} "For your own user account only."
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
  StrCpy $R2 0
  ReadRegStr $R3 HKCU "${RUN_KEY}" "${NAME}"
  ${If} $R3 != ""
    StrCpy $R2 1
  ${EndIf}
  ClearErrors
  !insertmacro Choose ${SectionAutostart} "AUTOSTART" $R2
  ClearErrors
FunctionEnd

; ---- Removal -----------------------------------------------------------------------------

; First, because the program itself takes its secrets out of the system's keyring.
Section /o "un.Settings, logs and secrets of your user account" SectionSettings
  Call un.CloseProgram
  nsExec::Exec '"$INSTDIR\${EXE}" secrets forget emotiv'
  Pop $R0
  SetShellVarContext current
  RMDir /r "$LOCALAPPDATA\${PROGRAM}"
  SetShellVarContext all
SectionEnd

Section "un.${NAME}"
  SectionIn RO
  Call un.CloseProgram
  nsExec::ExecToLog '"$INSTDIR\${EXE}" installation remove-from-path "$INSTDIR"'
  Pop $R0
  ReadRegDWORD $R0 HKLM "${OWN_KEY}" "Firewall"
  ${If} $R0 == 1
    nsExec::ExecToLog '"$SYSDIR\netsh.exe" advfirewall firewall delete rule name="${NAME}"'
    Pop $R0
  ${EndIf}
  DeleteRegKey HKLM "${OWN_KEY}"
  DeleteRegKey HKLM "${APP_PATH_KEY}"
  DeleteRegKey HKLM "${UNINSTALL_KEY}"
  DeleteRegValue HKCU "${RUN_KEY}" "${NAME}"

  Delete "$SMPROGRAMS\${NAME}\${NAME}.lnk"
  Delete "$SMPROGRAMS\${NAME}\Check this PC.lnk"
  Delete "$SMPROGRAMS\${NAME}\Settings.lnk"
  Delete "$SMPROGRAMS\${NAME}\Uninstall.lnk"
  RMDir "$SMPROGRAMS\${NAME}"

  ; Only what is ours: the folder itself goes if nothing else is in it.
  RMDir /r "$INSTDIR\_internal"
  RMDir /r "$INSTDIR\licenses"
  Delete "$INSTDIR\sbom.cdx.json"
  Delete "$INSTDIR\${EXE}"
  Delete "$INSTDIR\uninstall.exe"
  RMDir "$INSTDIR"
SectionEnd

Function un.onInit
  SetRegView 64
  SetShellVarContext all
  ${GetParameters} $R0
  ClearErrors
  ${GetOptions} $R0 "/REMOVE_SETTINGS=" $R1
  ${IfNot} ${Errors}
  ${AndIf} $R1 == 1
    !insertmacro SelectSection ${SectionSettings}
  ${EndIf}
  ClearErrors
FunctionEnd
